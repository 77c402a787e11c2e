"""What every chassis says of itself fits together: section, geometry, drawing."""

from math import cos, hypot, sin
from pathlib import Path
from typing import get_args

import pytest

from gateway.chassis import CHASSIS, AnyRobot
from gateway.config import load
from gateway.types import PLANAR
from replay.sim.plants import PLANTS

FOLDER = Path(__file__).parents[2] / "deploy" / "robots"
ROBOTS = {path.stem: load(path)[0].robot for path in sorted(FOLDER.glob("*.toml"))}
every = pytest.mark.parametrize("name", ROBOTS)


def test_both_lines_of_the_registry_name_the_same() -> None:
    assert set(get_args(AnyRobot)) == set(CHASSIS.values())
    assert len(get_args(AnyRobot)) == len(CHASSIS) == len(PLANTS)
    assert {robot.kind: type(robot) for robot in ROBOTS.values()} == CHASSIS, "a bundled robot of every kind"


@every
def test_geometry_has_a_row_for_every_motor_and_its_steered_joints_are_motors(name: str) -> None:
    robot = ROBOTS[name]
    kinematics = robot.kinematics()
    assert kinematics.axes == robot.AXES
    assert robot.AXES[:3] == PLANAR
    assert len(robot.masses()) == len(robot.AXES)
    assert {len(row) for row in kinematics.matrix()} == {len(robot.AXES)}
    assert len(kinematics.matrix()) == len(robot.motor_names()) == len(set(robot.motor_names()))
    assert set(kinematics.steered) <= set(range(len(robot.motor_names())))


@every
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


@every
@pytest.mark.parametrize("top_speed", [0.5, 1.0])
def test_a_faster_robot_needs_a_faster_loop(name: str, top_speed: float) -> None:
    limits = ROBOTS[name].loop_limits(top_speed, delay=0.004)
    slower = ROBOTS[name].loop_limits(top_speed / 2.0, delay=0.004)
    assert [limit.name for limit in limits] == [limit.name for limit in slower]
    assert all(0.0 < limit.period < other.period for limit, other in zip(limits, slower, strict=True))


def test_compensation_by_hand() -> None:
    """ln 3 x 0.25 m / 1.2 m/s = 0.2289 s, whatever 4 ms of age; wheels without a steered joint ask for nothing."""
    (limit,) = ROBOTS["moby"].loop_limits(1.2, delay=0.004)
    assert limit.name == "compensation"
    assert limit.period == pytest.approx(0.2289, abs=1e-4)
    assert ROBOTS["omni4"].loop_limits(1.2, delay=0.004) == ()


def test_way_and_time_until_it_flips_by_hand() -> None:
    """0.01 rad off: d1 ln(1/tan 0.005) = 0.25 m x 5.2983; nothing of one that is pushed, at rest or not measured."""
    _, flip = ROBOTS["moby"].channels()
    assert flip.read((3.1315926, 3.1415927, -0.01, 0.0, 1.2, 0.0)) == pytest.approx((1.32457, 1.10381), abs=1e-4)
    assert flip.read((0.1, 3.1415927, -3.0415927, 0.0, 1.2, 0.0)) == (None, None)
    assert flip.read((None, None, None, 0.0, None, None)) == (None, None)
