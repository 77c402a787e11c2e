"""What every motor does when it turns positively, read from the wheel matrix that the robot is driven with. Pure.

How this works
--------------
A row of the wheel matrix says how fast a motor turns per unit of each axis of the body. The wheel stands along its
rolling direction u; if a body that moves along u turns it positively, then it rolls along u when it turns positively,
else along -u. Times the radius, the first two numbers of the row are the direction g in which the wheel holds the
floor: r speed = g . v. At right angles to g it turns by nothing: there it slides on its rollers, whose axis lies along
g.
"""

from math import sqrt
from typing import Final, NamedTuple

from gateway.chassis.contract import Chassis, DrawnWheel, Point
from gateway.types import PLANAR

_X, _Y, _TURN = (PLANAR.index(axis) for axis in PLANAR)
_NONE: Final = 1e-12  # of a row: no part of it


class WheelSign(NamedTuple):
    """`way`: in which it rolls when it turns positively, as a unit vector (x forward, y left).

    `roller`: axis of the roller on the floor, None of a wheel without; it slides at right angles to it. `more`: m/s of
    the wheel to the left per unit of each axis beyond the twist, where that moves the wheel by itself.
    """

    motor: str
    wheel: DrawnWheel
    way: Point
    roller: Point | None
    more: tuple[float, ...] = ()


class JointSign(NamedTuple):
    """`turns`: 1.0 where the body turns counter-clockwise on what carries it, as seen from above, -1.0: clockwise."""

    motor: str
    turns: float


def signs(robot: Chassis) -> tuple[WheelSign | JointSign, ...]:
    """Of every motor, in chassis order, joints at zero. Raises GeometryError."""
    drawing, rows = robot.drawing(), robot.kinematics().matrix()
    wheels = iter(drawing.wheels)
    return tuple(
        JointSign(motor, 1.0 if row[_TURN] > 0.0 else -1.0)
        if place == drawing.beneath
        else _of_wheel(motor, next(wheels), row, rollers=drawing.rollers)
        for place, (motor, row) in enumerate(zip(robot.motor_names(), rows, strict=True))
    )


def _of_wheel(motor: str, wheel: DrawnWheel, row: tuple[float, ...], *, rollers: bool) -> WheelSign:
    forward, left = row[_X], row[_Y]
    ahead, aside = wheel.along
    sign = 1.0 if forward * ahead + left * aside > 0.0 else -1.0
    size = sqrt(forward * forward + left * left)
    more = tuple([part / left if abs(left) > _NONE else 0.0 for part in row[len(PLANAR) :]])
    return WheelSign(
        motor, wheel, (sign * ahead, sign * aside), (forward / size, left / size) if rollers else None, more
    )
