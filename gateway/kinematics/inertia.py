"""Inertia of each chassis kind about its body axes, as the motors feel it; the rotors of the joints are left out."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from gateway.arithmetic import sin_cos
from gateway.config import OffsetDifferentialRobot, OmniRobot
from gateway.kinematics.linear import Matrix

Inertia = Callable[[Sequence[float]], Matrix]  # of the joint angles, rad: kg, kg m, kg m^2


def _omni(robot: OmniRobot) -> Inertia:
    body = robot.body
    matrix = ((body.mass, 0.0, 0.0), (0.0, body.mass, 0.0), (0.0, 0.0, body.inertia))
    return lambda _: matrix


def _offset_differential(robot: OffsetDifferentialRobot) -> Inertia:
    """The chassis turns at (n . v)/d1 below the joint, so a motion across it also turns it: mass + I_c/d1^2 along n."""
    mass, turning = robot.body.mass, robot.chassis_inertia / (robot.axle_offset * robot.axle_offset)
    platform = robot.motor_names().index(robot.platform)

    def inertia(angles: Sequence[float]) -> Matrix:
        s, c = sin_cos(angles[platform])
        mixed = turning * s * c
        return (
            (mass + turning * s * s, mixed, 0.0),
            (mixed, mass + turning * c * c, 0.0),
            (0.0, 0.0, robot.body.inertia),
        )

    return inertia


INERTIA: Final[dict[str, Callable[[Any], Inertia]]] = {"omni": _omni, "offset_differential": _offset_differential}
