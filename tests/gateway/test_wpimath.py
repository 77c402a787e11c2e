"""Against WPILib's mathematics: the 45-degree omni robot, the wheels below moby's joint, poses along an arc.

A mecanum wheel pulls along the axes of its rollers, an omni wheel along the way it rolls. Rollers at 45 degrees pull as
the omni wheels of that robot do at the same places; only the surface of the wheel is faster by sqrt 2, because it does
not roll along its pull but at 45 degrees to it. On the left an axle that points outward rolls backward where WPILib
counts forward. So a mecanum wheel's speed is -sqrt 2 times our rim speed on the left, +sqrt 2 on the right.
"""

from importlib import import_module
from math import cos, pi, sin, sqrt
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.config import parse
from gateway.core.odometry import advance
from gateway.kinematics.contract import desaturate
from gateway.types import Displacement, Pose, Twist
from tests.world import robot_text

geometry: Any = import_module("wpimath.geometry")  # has no types
kinematics: Any = import_module("wpimath.kinematics")

ARM, RADIUS = 0.28, 0.0762
ORDER = ("frontLeft", "rearLeft", "rearRight", "frontRight")  # ours: counter-clockwise from forward
SURFACE = (-sqrt(2.0), -sqrt(2.0), sqrt(2.0), sqrt(2.0))
ANGLES = [degrees * pi / 180.0 for degrees in (45, 135, 225, 315)]
OMNI = omni_kinematics([WheelPose(ARM * cos(a), ARM * sin(a), a, RADIUS) for a in ANGLES])
Q = ARM / sqrt(2.0)
MECANUM = kinematics.MecanumDriveKinematics(
    *[geometry.Translation2d(x, y) for x, y in ((Q, Q), (Q, -Q), (-Q, Q), (-Q, -Q))]
)
speeds = st.floats(-5.0, 5.0)
turns = st.floats(-8.0, 8.0)


def as_mecanum(wheels: list[float]) -> list[float]:
    """rad/s of our wheels as surface speeds of theirs."""
    return [speed * RADIUS * factor for speed, factor in zip(wheels, SURFACE, strict=True)]


@given(speeds, speeds, turns)
def test_wheel_speeds_are_those_of_a_mecanum_robot(vx: float, vy: float, wz: float) -> None:
    theirs = MECANUM.toWheelSpeeds(kinematics.ChassisSpeeds(vx, vy, wz))
    ours = as_mecanum(OMNI.wheel_speeds(Twist(vx, vy, wz)))
    assert ours == pytest.approx([getattr(theirs, name) for name in ORDER], abs=1e-12)


@given(st.lists(speeds, min_size=4, max_size=4))
def test_the_twist_of_any_wheels_is_theirs_too_also_where_they_slip(rims: list[float]) -> None:
    """Least squares on both sides; all rows are longer by the same factor, so the fit is the same."""
    by_name = dict(zip(ORDER, as_mecanum([rim / RADIUS for rim in rims]), strict=True))
    theirs = MECANUM.toChassisSpeeds(kinematics.MecanumDriveWheelSpeeds(**by_name))
    ours = OMNI.twist([rim / RADIUS for rim in rims])
    assert ours is not None
    assert tuple(ours.twist) == pytest.approx((theirs.vx, theirs.vy, theirs.omega), abs=1e-12)


@given(speeds, speeds, turns, st.floats(0.1, 10.0))
def test_too_fast_wheels_are_slowed_alike(vx: float, vy: float, wz: float, limit: float) -> None:
    wheels = OMNI.wheel_speeds(Twist(vx, vy, wz))
    theirs = MECANUM.toWheelSpeeds(kinematics.ChassisSpeeds(vx, vy, wz))
    theirs.desaturate(limit)
    share = desaturate(wheels, [limit / (RADIUS * sqrt(2.0))] * 4)
    ours = as_mecanum([speed * share for speed in wheels])
    assert ours == pytest.approx([getattr(theirs, name) for name in ORDER], abs=1e-12)


@settings(max_examples=50)
@given(speeds, speeds, st.floats(-pi, pi))
def test_the_wheels_below_the_joint_of_moby_are_a_differential_drive(vx: float, vy: float, joint: float) -> None:
    """Its axle, 0.25 m behind the joint: along it goes what is along the chassis, across it turns the chassis."""
    moby = parse(robot_text("moby"), "moby").robot.kinematics()
    along, across = cos(joint) * vx - sin(joint) * vy, sin(joint) * vx + cos(joint) * vy
    theirs = kinematics.DifferentialDriveKinematics(0.4).toWheelSpeeds(
        kinematics.ChassisSpeeds(along, 0.0, across / 0.25)
    )
    wheels = moby.wheel_speeds(Twist(vx, vy, 0.0), [None, None, joint])
    assert wheels is not None
    assert [wheels[0] * 0.1, wheels[1] * 0.1] == pytest.approx([theirs.left, theirs.right], abs=1e-12)


@given(st.tuples(speeds, speeds, turns), st.tuples(speeds, speeds, st.floats(-3.0, 3.0)))
def test_the_pose_after_an_arc_is_theirs(way: tuple[float, ...], start: tuple[float, ...]) -> None:
    ours = advance(Pose(*start), Displacement(*way))
    theirs = geometry.Pose2d(*start).exp(geometry.Twist2d(*way))
    assert (ours.x, ours.y) == pytest.approx((theirs.x, theirs.y), abs=1e-9)
    assert (cos(ours.theta), sin(ours.theta)) == pytest.approx((theirs.rotation().cos(), theirs.rotation().sin()))
