"""Geometry of each chassis kind. A new chassis is one file here and one line in `KINEMATICS`."""

from collections.abc import Callable
from typing import Any, Final

from gateway.config import OffsetDifferentialRobot, OmniRobot
from gateway.kinematics.contract import Kinematics
from gateway.kinematics.offset_differential import CasterGeometry, OffsetDifferentialKinematics
from gateway.kinematics.omni import OmniKinematics, WheelPose


def _omni(robot: OmniRobot) -> Kinematics:
    return OmniKinematics([WheelPose(wheel.x, wheel.y, wheel.axis_angle, wheel.radius) for wheel in robot.wheel])


def _offset_differential(robot: OffsetDifferentialRobot) -> Kinematics:
    caster = None
    if robot.caster is not None:
        caster = CasterGeometry(robot.caster.trail, robot.caster.position, robot.caster.radius)
    return OffsetDifferentialKinematics(
        wheel_radius=robot.wheel_radius, axle_offset=robot.axle_offset, track=robot.track, caster=caster
    )


KINEMATICS: Final[dict[str, Callable[[Any], Kinematics]]] = {
    "omni": _omni,
    "offset_differential": _offset_differential,
}
