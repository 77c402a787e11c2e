"""Robots on four omni wheels in the service: their robot files, and driving them."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from gateway.chassis.omni import OmniRobot
from gateway.config import RobotConfig, parse
from gateway.types import Pose
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.result import Stage
from replay.reproduce.robot import ORIGIN
from replay.reproduce.service import Driven, Order, drive_in
from replay.sim.plants.contract import PlantName
from replay.sim.plants.omni_dynamics import Stribeck, plant


class FileWheel(NamedTuple):
    """As in the robot file: contact point, angle of the axle, radius, mass of a roller (None: unsaid)."""

    motor: str
    x: float
    y: float
    axis_angle: float
    radius: float
    roller_mass: float | None = None


class OmniFile(NamedTuple):
    """What differs between these robots. `motor`: lines of each motor; `velocity` and the next two: limits by axis.

    `centre_height`: m, None: unsaid; `friction`: of the floor, for launches, None: none are made.
    """

    title: str
    name: str
    mass: float
    inertia: float
    joint_inertia: float
    wheels: tuple[FileWheel, ...]
    motor: str
    motor_speed: float
    velocity: Mapping[str, float]
    acceleration: Mapping[str, float]
    jerk: Mapping[str, float]
    centre_height: float | None = None
    friction: float | None = None


def robot_file(file: OmniFile) -> tuple[RobotConfig, str]:
    """The configuration and its text."""
    text = _ROBOT.format_map(
        file._asdict()
        | {name: _inline(getattr(file, name)) for name in ("velocity", "acceleration", "jerk")}
        | {
            "motor_speed": _inline({wheel.motor: file.motor_speed for wheel in file.wheels}),
            "wheels": "".join(map(_wheel, file.wheels)),
            "height": "" if file.centre_height is None else f"centre_height = {file.centre_height!r}\n",
            "grip": "" if file.friction is None else f"\n[robot.grip]\nfriction = {file.friction!r}\n",
            "motors": "".join(
                _MOTOR.format(name=wheel.motor, number=number, lines=file.motor)
                for number, wheel in enumerate(file.wheels, start=1)
            ),
        }
    )
    return parse(text, ORIGIN), text


def drive_omni(
    stage: Stage,
    file: OmniFile,
    wanted: Callable[[float, Pose], Order],
    seconds: float,
    disturb: Callable[[ClosedLoop, float], None] = lambda loop, t: None,
    *,
    stribeck: Stribeck | None = None,
) -> Driven:
    """Driven through the service, on the full dynamics; `disturb`: what else happens before a cycle at this time, s.

    `stribeck`: how friction falls with slip; None: it does not.
    """
    config, text = robot_file(file)
    assert isinstance(config.robot, OmniRobot)  # that is its kind
    own = plant(config.robot)
    own.stribeck = stribeck
    loop = ClosedLoop(config, plant=own)
    return drive_in(loop, text, PlantName.DYNAMICS, wanted, stage, seconds=seconds, disturb=lambda t: disturb(loop, t))


def _inline(values: Mapping[str, float]) -> str:
    return "{ " + ", ".join(f"{name} = {value!r}" for name, value in values.items()) + " }"


def _wheel(wheel: FileWheel) -> str:
    lines = [f"{name} = {value!r}" for name, value in wheel._asdict().items() if name != "motor" and value is not None]
    return "\n".join(["", "[[robot.wheel]]", f'motor = "{wheel.motor}"', *lines, ""])


_MOTOR = """
[[motor]]
name = "{name}"
driver = "dji"
bus = "can0"
id = {number}
direction = 1
feedback_rate = 1000.0
watchdog_waiver = "this robot exists in the simulation only"
{lines}
"""

_ROBOT = """# {title}

[robot]
kind = "omni"
name = "{name}"

[robot.body]
mass = {mass!r}
inertia = {inertia!r}
joint_friction = 0.0
joint_drag = 0.0
joint_inertia = {joint_inertia!r}
{height}{wheels}{grip}
[loop]
rate = 250.0

[limits]
velocity = {velocity}
acceleration = {acceleration}
jerk = {jerk}
motor_speed = {motor_speed}

[[bus]]
name = "can0"
interface = "socketcan"
channel = "can0"
bitrate = 1_000_000
{motors}
[commands]
source = [{{ name = "experiment", priority = 1, timeout = 0.1 }}]
"""
