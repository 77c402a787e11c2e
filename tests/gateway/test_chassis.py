"""What every chassis says of itself fits together: section, geometry, drawing."""

from math import cos, hypot, sin
from typing import get_args

import pytest

from gateway.chassis import CHASSIS, AnyRobot
from gateway.config import parse
from replay.sim.plants import PLANTS
from tests.world import NAMES, robot_text

ROBOTS = {name: parse(robot_text(name), name).robot for name in NAMES}


def test_both_lines_of_the_registry_name_the_same() -> None:
    assert set(get_args(AnyRobot)) == set(CHASSIS.values())
    assert len(get_args(AnyRobot)) == len(CHASSIS) == len(PLANTS)
    assert {robot.kind: type(robot) for robot in ROBOTS.values()} == CHASSIS, "a bundled robot of every kind"


@pytest.mark.parametrize("name", NAMES)
def test_geometry_has_a_row_for_every_motor_and_its_steered_joints_are_motors(name: str) -> None:
    robot = ROBOTS[name]
    kinematics = robot.kinematics()
    assert len(kinematics.matrix()) == len(robot.motor_names()) == len(set(robot.motor_names()))
    assert set(kinematics.steered) <= set(range(len(robot.motor_names())))


@pytest.mark.parametrize("name", NAMES)
def test_the_drawing_fits_the_geometry(name: str) -> None:
    robot = ROBOTS[name]
    drawing = robot.drawing()
    assert drawing.reach > 0.0
    assert drawing.wheels
    assert all(wheel.radius > 0.0 for wheel in drawing.wheels)
    assert (drawing.beneath is None) == (not robot.kinematics().steered)
    assert drawing.beneath is None or drawing.beneath in robot.kinematics().steered
    assert drawing.frame == () or drawing.frame[0] == drawing.frame[-1], "a closed line"


def test_drawings_by_hand() -> None:
    """moby: axle 0.25 m behind the joint, track 0.4 m; omni4: wheels that roll at right angles to their axles."""
    moby, omni = ROBOTS["moby"].drawing(), ROBOTS["omni4"].drawing()
    assert [(wheel.x, wheel.y, wheel.rolling) for wheel in moby.wheels] == [(-0.25, 0.2, 0.0), (-0.25, -0.2, 0.0)]
    assert (moby.reach, moby.beneath) == (0.25, 2)
    assert omni.reach == pytest.approx(max(hypot(wheel.x, wheel.y) for wheel in omni.wheels))
    for wheel, (along, across, _) in zip(omni.wheels, ROBOTS["omni4"].kinematics().matrix(), strict=True):
        length = hypot(along, across)
        assert (along / length, across / length) == pytest.approx((cos(wheel.rolling), sin(wheel.rolling)))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("top_speed", [0.5, 1.0])
def test_a_faster_robot_needs_a_faster_loop(name: str, top_speed: float) -> None:
    limits = ROBOTS[name].loop_limits(top_speed, delay=0.004)
    assert [limit.name for limit in limits] == ["compensation"] * (name == "moby")
    assert all(limit.period == pytest.approx(1.0986 * 0.25 / top_speed - 0.004, rel=1e-4) for limit in limits)
