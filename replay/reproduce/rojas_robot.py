"""Four-wheeled robots of Rojas, Omnidirectional Control (2005), in the service: robot files, and driving them.

The paper's angles are those of the axles from the right-hand side; ours count from forward, a quarter turn less. Its
numbers have no robot: mass, size and motors are ours.
"""

from collections.abc import Callable, Sequence
from math import cos, pi, radians, sin
from typing import Final, NamedTuple

from gateway.types import Pose
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.omni_robot import FileWheel, OmniFile, drive_omni
from replay.reproduce.result import Stage
from replay.reproduce.service import Driven, Order
from replay.sim.controllers.dc_motor import DcMotor

MASS: Final = 25.0  # kg
TORQUE: Final = 4.5  # N m of a motor at the wheel
WHEEL_RADIUS: Final = 0.0762  # m
FORCE: Final = TORQUE / WHEEL_RADIUS  # N that a motor pushes with at most
CIRCLE: Final = 0.2  # m, of the wheels
DIRECT_MASS: Final = 8.0  # kg, of the robot on motors that take a voltage
DIRECT_RADIUS: Final = 0.0508  # m, of its wheels
WINDING: Final = DcMotor(resistance=8.7, constant=0.741)  # of its motors, GM6020
SUPPLY: Final = 24.0  # V
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


def rojas_file(layout: Layout, *, acceleration: float = 2.0) -> OmniFile:
    """`acceleration`: its limit along each axis, m/s^2."""
    return OmniFile(
        title="A four-wheeled robot of Rojas, Omnidirectional Control (2005), as driven here. SI units.",
        name="rojas",
        mass=MASS,
        inertia=0.9,
        joint_inertia=0.0004,
        wheels=_wheels(layout, WHEEL_RADIUS),
        motor=_MOTOR,
        motor_speed=45.0,
        velocity={"vx": 2.0, "vy": 2.0, "wz": 4.0},
        acceleration={"vx": acceleration, "vy": acceleration, "wz": 6.0},
        jerk={"vx": 100.0 * acceleration, "vy": 100.0 * acceleration, "wz": 40.0},
    )


def direct_drive_file(*, centre_height: float | None, friction: float | None) -> OmniFile:
    """A lighter one on motors that take a voltage, eager to speed up; `friction`: of the floor, as it is told it."""
    return OmniFile(
        title="A four-wheeled robot of Rojas, Omnidirectional Control (2005), on motors that take a voltage. SI units.",
        name="rojas_volts",
        mass=DIRECT_MASS,
        inertia=0.15,
        joint_inertia=0.0006,
        wheels=_wheels(SYMMETRIC, DIRECT_RADIUS),
        motor=_DIRECT_MOTOR,
        motor_speed=24.0,
        velocity={"vx": 1.4, "vy": 1.4, "wz": 4.0},
        acceleration={"vx": 9.0, "vy": 9.0, "wz": 30.0},
        jerk={"vx": 150.0, "vy": 150.0, "wz": 400.0},
        centre_height=centre_height,
        friction=friction,
    )


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
    return drive_omni(stage, rojas_file(layout, acceleration=acceleration), wanted, seconds, disturb)


def wheel_directions(layout: Layout) -> tuple[tuple[float, float], ...]:
    """Of each wheel where it rolls to, forward and to the left."""
    return tuple((-sin(axle - pi / 2.0), cos(axle - pi / 2.0)) for axle in layout.axles)


def rim_speeds(layout: Layout, vx: float, vy: float, wz: float = 0.0) -> Sequence[float]:
    """m/s that the wheels roll with in a motion of the body, m/s and rad/s."""
    return [x * vx + y * vy + CIRCLE * wz for x, y in wheel_directions(layout)]


def ahead(direction: float) -> tuple[float, float]:
    """Forward and to the left, of a direction in deg from the right-hand side."""
    angle = radians(direction) - pi / 2.0
    return cos(angle), sin(angle)


def towards(direction: float, speed: float) -> Order:
    """The velocity in such a direction."""
    x, y = ahead(direction)
    return Order(speed * x, speed * y)


def _wheels(layout: Layout, radius: float) -> tuple[FileWheel, ...]:
    angles = [axle - pi / 2.0 for axle in layout.axles]
    return tuple(
        FileWheel(name, CIRCLE * cos(angle), CIRCLE * sin(angle), angle, radius)
        for name, angle in zip(MOTORS, angles, strict=True)
    )


_MOTOR = f"""variant = "c620"
gear_ratio = 19.0
max_current = 20.0
max_torque = {TORQUE}
max_speed = 48.0
speed_loop = {{ kp = 3.5, ki = 14.0 }}"""
_DIRECT_MOTOR = f"""variant = "gm6020"
gear_ratio = 1.0
max_current = 1.62
max_torque = 1.2
max_speed = 26.0
speed_loop = {{ kp = 0.5, ki = 1.2 }}
options = {{ mode = "voltage" }}
winding = {{ resistance = {WINDING.resistance}, back_emf = {WINDING.constant}, voltage = {SUPPLY} }}"""
