"""Four-wheeled robots of Rojas, Omnidirectional Control (2005), in the service: robot files, and driving them.

The paper's angles are those of the axles from the right-hand side; ours count from forward, a quarter turn less. Its
numbers have no robot: mass, size and motors are ours.
"""

from collections.abc import Callable, Sequence
from math import cos, pi, radians, sin
from typing import Final, NamedTuple

from gateway.config import RobotConfig, parse
from gateway.types import Pose
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.result import Stage
from replay.reproduce.robot import ORIGIN
from replay.reproduce.service import Driven, Order, drive_in
from replay.sim.plants.contract import PlantName

MASS: Final = 25.0  # kg
TORQUE: Final = 4.5  # N m of a motor at the wheel
WHEEL_RADIUS: Final = 0.0762  # m
FORCE: Final = TORQUE / WHEEL_RADIUS  # N that a motor pushes with at most
CIRCLE: Final = 0.2  # m, of the wheels
MOTORS: Final = ("front_right", "front_left", "rear_left", "rear_right")  # 1 to 4 of the paper


class Layout(NamedTuple):
    """Angles of the axles in front and behind from the right-hand side (phi and theta), degrees."""

    front: float
    rear: float

    @property
    def axles(self) -> tuple[float, ...]:
        """From the right-hand side, rad, of the wheels 1 to 4."""
        front, rear = radians(self.front), radians(self.rear)
        return front, pi - front, pi + rear, -rear


SYMMETRIC: Final = Layout(30.0, 30.0)


def rojas_robot_file(layout: Layout, *, acceleration: float) -> tuple[RobotConfig, str]:
    """The configuration and its text; `acceleration`: its limit along each axis, m/s^2."""
    wheels = []
    for name, axle in zip(MOTORS, layout.axles, strict=True):
        angle = axle - pi / 2.0
        wheels.append(_WHEEL.format(name=name, x=CIRCLE * cos(angle), y=CIRCLE * sin(angle), axis=angle))
    text = _ROBOT.format(
        acceleration=acceleration,
        jerk=100.0 * acceleration,
        wheels="".join(wheels),
        motors="".join(_MOTOR.format(name=name, number=number) for number, name in enumerate(MOTORS, start=1)),
    )
    return parse(text, ORIGIN), text


def driven(
    stage: Stage,
    layout: Layout,
    wanted: Callable[[float, Pose], Order],
    seconds: float,
    *,
    acceleration: float = 2.0,
    disturb: Callable[[ClosedLoop, float], None] = lambda loop, t: None,
) -> Driven:
    """Driven through the service; `disturb`: what else happens before a cycle at this time, s."""
    config, text = rojas_robot_file(layout, acceleration=acceleration)
    loop = ClosedLoop(config)
    return drive_in(loop, text, PlantName.SIMPLE, wanted, stage, seconds=seconds, disturb=lambda t: disturb(loop, t))


def wheel_directions(layout: Layout) -> tuple[tuple[float, float], ...]:
    """Of each wheel where it rolls to, forward and to the left."""
    return tuple((-sin(axle - pi / 2.0), cos(axle - pi / 2.0)) for axle in layout.axles)


def rim_speeds(layout: Layout, vx: float, vy: float, wz: float = 0.0) -> Sequence[float]:
    """m/s that the wheels roll with in a motion of the body, m/s and rad/s."""
    return [x * vx + y * vy + CIRCLE * wz for x, y in wheel_directions(layout)]


_WHEEL = """
[[robot.wheel]]
motor = "{name}"
x = {x!r}
y = {y!r}
axis_angle = {axis!r}
radius = 0.0762
"""

_MOTOR = """
[[motor]]
name = "{name}"
driver = "dji"
variant = "c620"
bus = "can0"
id = {number}
gear_ratio = 19.0
direction = 1
max_current = 20.0
max_torque = 4.5
max_speed = 48.0
feedback_rate = 1000.0
watchdog_waiver = "this robot exists in the simulation only"
speed_loop = {{ kp = 3.5, ki = 14.0 }}
"""

_ROBOT = """# A four-wheeled robot of Rojas, Omnidirectional Control (2005), as driven here. SI units.

[robot]
kind = "omni"
name = "rojas"

[robot.body]
mass = 25.0
inertia = 0.9
joint_friction = 0.0
joint_drag = 0.0
joint_inertia = 0.0004
{wheels}
[loop]
rate = 250.0

[limits]
velocity = {{ vx = 2.0, vy = 2.0, wz = 4.0 }}
acceleration = {{ vx = {acceleration!r}, vy = {acceleration!r}, wz = 6.0 }}
jerk = {{ vx = {jerk!r}, vy = {jerk!r}, wz = 40.0 }}
motor_speed = {{ front_right = 45.0, front_left = 45.0, rear_left = 45.0, rear_right = 45.0 }}

[[bus]]
name = "can0"
interface = "socketcan"
channel = "can0"
bitrate = 1_000_000
{motors}
[commands]
source = [{{ name = "experiment", priority = 1, timeout = 0.1 }}]
"""
