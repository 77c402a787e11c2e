"""The robot of ASME Lett. Dyn. Sys. Control 2(4):040902 in the service: its robot file, in SI, and driving it."""

from collections.abc import Callable, Sequence
from math import pi
from typing import Final

from gateway.config import RobotConfig, parse
from gateway.types import Pose
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.kane_model import LEVER, POUND, RADIUS, KaneRobot
from replay.reproduce.result import Stage
from replay.reproduce.robot import ORIGIN
from replay.reproduce.service import Driven, Order, Sample, drive_in
from replay.sim.plants.contract import PlantName

INCH: Final = 0.0254  # m
SLUG: Final = 14.593903  # kg
NEWTON: Final = 4.448222 / POUND  # in a slug in/s^2
RATE: Final = 250.0  # Hz
UNITS_NOTE = (
    "Inferred, not printed: wheels 3 and 4 turn against each other in a spin (the printed cross products give no spin "
    "at all), 8 in from the centre to a wheel, 'lb-in' means slug in^2/s^2 in the tracking experiments, a figure eight "
    "takes 25 s, and the wheel control is the one whose torque is a state. These readings were chosen because their "
    "torques fit the printed ranges; errors of wheels and spin were not used for it."
)
_SETTLED = 0.5  # s, after which a commanded velocity is reached
_INERTIA: Final = SLUG * INCH * INCH  # kg m^2 in a slug in^2
_WHEELS = (  # name, place, axle from forward: they roll along a1, a1, a2, a2
    ("left", (0.0, LEVER), -pi / 2.0),
    ("right", (0.0, -LEVER), -pi / 2.0),
    ("rear", (-LEVER, 0.0), 0.0),
    ("front", (LEVER, 0.0), 0.0),
)


def kane_robot_file() -> tuple[RobotConfig, str]:
    """The configuration and its text. Its limits leave the commands as the experiments give them.

    Motors and their gains are ours (the paper has torques and no motor); mass and inertias are the paper's.
    """
    robot = KaneRobot()
    spin = float(robot.inertia[0, 0]) - robot.mass  # of two wheels and two rollers, as mass at the rim
    text = _ROBOT.format(
        mass=robot.mass * SLUG,
        inertia=(float(robot.inertia[2, 2]) - 2.0 * spin * LEVER * LEVER) * _INERTIA,
        joint_inertia=0.5 * spin * RADIUS * RADIUS * _INERTIA,
        rate=RATE,
        wheels="".join(
            _WHEEL.format(name=name, x=place[0] * INCH, y=place[1] * INCH, axis=axis, radius=RADIUS * INCH)
            for name, place, axis in _WHEELS
        ),
        motors="".join(_MOTOR.format(name=name, number=number) for number, (name, *_) in enumerate(_WHEELS, start=1)),
    )
    return parse(text, ORIGIN), text


def driven(
    stage: Stage,
    wanted: Callable[[float, Pose], Order],
    seconds: float,
    disturb: Callable[[ClosedLoop, float], None] = lambda loop, t: None,
) -> Driven:
    """Driven through the service; `disturb`: what else happens before a cycle at this time, s."""
    config, text = kane_robot_file()
    loop = ClosedLoop(config)
    return drive_in(loop, text, PlantName.SIMPLE, wanted, stage, seconds=seconds, disturb=lambda t: disturb(loop, t))


def settled(samples: Sequence[Sample]) -> list[Sample]:
    """Those at the commanded velocity."""
    return [sample for sample in samples if sample.t >= _SETTLED]


_WHEEL = """
[[robot.wheel]]
motor = "{name}"
x = {x!r}
y = {y!r}
axis_angle = {axis!r}
radius = {radius!r}
"""

_MOTOR = """
[[motor]]
name = "{name}"
driver = "dji"
variant = "c610"
bus = "can0"
id = {number}
gear_ratio = 36.0
direction = 1
max_current = 10.0
max_torque = 1.8
max_speed = 45.0
feedback_rate = 1000.0
watchdog_waiver = "this robot exists in the simulation only"
speed_loop = {{ kp = 0.35, ki = 2.0 }}
"""

_ROBOT = """# The omni robot of ASME Lett. Dyn. Sys. Control 2(4):040902, as its experiments are driven here. SI units.

[robot]
kind = "omni"
name = "kane"

[robot.body]
mass = {mass!r}
inertia = {inertia!r}
joint_friction = 0.0
joint_drag = 0.0
joint_inertia = {joint_inertia!r}
{wheels}
[loop]
rate = {rate!r}

[limits]
velocity = {{ vx = 1.0, vy = 1.0, wz = 6.0 }}
acceleration = {{ vx = 5.0, vy = 5.0, wz = 40.0 }}
jerk = {{ vx = 1000.0, vy = 1000.0, wz = 5000.0 }}
motor_speed = {{ left = 30.0, right = 30.0, rear = 30.0, front = 30.0 }}

[[bus]]
name = "can0"
interface = "socketcan"
channel = "can0"
bitrate = 1_000_000
{motors}
[commands]
source = [{{ name = "experiment", priority = 1, timeout = 0.1 }}]
"""
