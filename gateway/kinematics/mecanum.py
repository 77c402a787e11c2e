"""Mecanum wheels that all roll forward, anywhere on the body: one row per wheel, from the axis of its roller.

How this works
--------------
The roller that touches the floor turns freely about its axis, so the wheel only holds its contact point along that
axis: r thetadot cos a = vx cos a + vy sin a, with a the angle of the axis from forward and (vx, vy) the velocity of the
body over the contact point. Divided by cos a that is the row (1, tan a, tan a x - y) of vx, vy and wz; a wheel on a
part that moves sideways by itself has one number more (arXiv 2407.10127, equation 12).
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from gateway.arithmetic import sin_cos
from gateway.kinematics.contract import GeometryError
from gateway.kinematics.fixed_wheels import FixedWheels

MIN_COSINE: Final = 1e-3  # of a roller's axis from forward: across it the wheel rolls without driving anything


class MecanumWheel(NamedTuple):
    """Contact point (m), axis of the roller on the floor, counter-clockwise from forward (rad), radius (m)."""

    x: float
    y: float
    roller_angle: float
    radius: float


def mecanum_kinematics(wheels: Sequence[MecanumWheel]) -> FixedWheels:
    """Kinematics of these wheels. Raises GeometryError unless they have three distinct directions."""
    return FixedWheels([_rim_row(wheel) for wheel in wheels], [wheel.radius for wheel in wheels])


def roller_tangent(angle: float) -> float:
    """Metres at the rim per metre to the left. Raises GeometryError for a roller that turns across the wheel."""
    sine, cosine = sin_cos(angle)
    if not abs(cosine) >= MIN_COSINE:
        message = f"roller_angle = {angle:g} rad: its axis lies across the wheel (cosine {cosine:.2g}, at least"
        raise GeometryError(f"{message} {MIN_COSINE:g} either way): such a wheel drives nothing")
    return sine / cosine


def _rim_row(wheel: MecanumWheel) -> tuple[float, float, float]:
    tangent = roller_tangent(wheel.roller_angle)
    return 1.0, tangent, tangent * wheel.x - wheel.y
