"""The robot of ASME Lett. Dyn. Sys. Control 2(4):040902 in the service: its robot file, in SI, and driving it."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from gateway.types import Pose
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.kane_model import POUND
from replay.reproduce.omni_robot import FileWheel, OmniFile, drive_omni
from replay.reproduce.picture import Line, Panel
from replay.reproduce.result import Stage
from replay.reproduce.service import Driven, Order, Sample
from replay.sim.plants.omni_parameters import INCH, ROLLER_SHARE, WheelParameters, kane_robot

NEWTON: Final = 4.448222 / POUND  # in a slug in/s^2
UNITS_NOTE = (
    "Inferred, not printed: wheels 3 and 4 turn against each other in a spin (the printed cross products give no spin "
    "at all), 8 in from the centre to a wheel, 'lb-in' means slug in^2/s^2 in the tracking experiments, a figure eight "
    "takes 25 s, and the wheel control is the one whose torque is a state. These readings were chosen because their "
    "torques fit the printed ranges; errors of wheels and spin were not used for it."
)
_SETTLED = 0.5  # s, after which a commanded velocity is reached
_MOTORS = ("left", "right", "rear", "front")  # 1 to 4 of the paper
MAX_TORQUE: Final = 1.8  # N m of a motor


class Loop(NamedTuple):
    """Gains of the service's speed loop, N m s/rad and N m/rad."""

    kp: float
    ki: float


OWN_LOOP: Final = Loop(0.35, 2.0)


def kane_file(loop: Loop = OWN_LOOP) -> OmniFile:
    """Its limits leave the commands as the experiments give them.

    Motors and their gains are ours (the paper has torques and no motor). A robot file knows one inertia for all joints:
    the mean of the paper's two, which are 1 % off it.
    """
    robot = kane_robot()
    spins = [wheel.spin_inertia for wheel in robot.wheels]
    return OmniFile(
        title="The omni robot of ASME Lett. Dyn. Sys. Control 2(4):040902, as driven here. SI units.",
        name="kane",
        mass=robot.mass,
        inertia=robot.inertia,
        joint_inertia=sum(spins) / len(spins),
        wheels=tuple(_wheel(name, wheel) for name, wheel in zip(_MOTORS, robot.wheels, strict=True)),
        motor=_MOTOR.format_map(loop._asdict()),
        motor_speed=30.0,
        velocity={"vx": 1.0, "vy": 1.0, "wz": 6.0},
        acceleration={"vx": 5.0, "vy": 5.0, "wz": 40.0},
        jerk={"vx": 1000.0, "vy": 1000.0, "wz": 5000.0},
    )


def driven(
    stage: Stage,
    wanted: Callable[[float, Pose], Order],
    seconds: float,
    disturb: Callable[[ClosedLoop, float], None] = lambda loop, t: None,
    loop: Loop = OWN_LOOP,
) -> Driven:
    """Driven through the service; `disturb`: what else happens before a cycle at this time, s."""
    return drive_omni(stage, kane_file(loop), wanted, seconds, disturb)


def settled(samples: Sequence[Sample]) -> list[Sample]:
    """Those at the commanded velocity."""
    return [sample for sample in samples if sample.t >= _SETTLED]


def seen_from_above(samples: Sequence[Sample], *others: Line, start: tuple[float, float] = (0.0, 0.0)) -> Panel:
    """What was driven, in inches from `start` on, over what it is held against."""
    xs, ys = [s.x / INCH + start[0] for s in samples], [s.y / INCH + start[1] for s in samples]
    return Panel(
        "From above", "q1 [in]", "q2 [in]", lines=(*others, Line("through the service", xs, ys, 1)), to_scale=True
    )


def _wheel(name: str, wheel: WheelParameters) -> FileWheel:
    """Its roller, solid in a robot file, has the inertia of the paper's."""
    roller = wheel.radius * ROLLER_SHARE
    mass = 2.0 * wheel.roller_inertia / (roller * roller)
    return FileWheel(name, wheel.x, wheel.y, wheel.axis_angle, wheel.radius, mass)


_MOTOR = f"""variant = "c610"
gear_ratio = 36.0
max_current = 10.0
max_torque = {MAX_TORQUE}
max_speed = 45.0
speed_loop = {{{{ kp = {{kp!r}}, ki = {{ki!r}} }}}}"""
