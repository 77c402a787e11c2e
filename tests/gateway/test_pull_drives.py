"""Drives of the paper in the pull region, kinematic: M1, M2, M15, M16, M18 and M19 of science section 6."""

import math

import pytest

from gateway.control.compensation import Compensation, RegionAt
from gateway.control.pull_region import Region
from gateway.kinematics.offset_differential import OffsetDifferentialKinematics
from gateway.paths.path import Path, Piece
from gateway.types import Pose, Twist
from tests.pulled import PulledRobot

D1 = 0.145  # m, of the real robot
RIGHT_ANGLE = (RegionAt(0.0, math.pi / 2),)


OFFSET = OffsetDifferentialKinematics(wheel_radius=0.1, axle_offset=0.25, track=0.4)


@pytest.mark.parametrize("joint", [-3.0, -1.5708, -0.4, 0.0, 1.1, 2.5])
def test_both_directions_are_each_others_inverse_m1(joint: float) -> None:
    places = [None, None, joint]
    for twist in (Twist(1.0, 0.0, 0.0), Twist(0.0, 1.0, 0.0), Twist(0.0, 0.0, 1.0), Twist(-0.3, 0.7, 2.0)):
        speeds = OFFSET.wheel_speeds(twist, places)
        assert speeds is not None
        estimate = OFFSET.twist(speeds, places)
        assert estimate is not None
        assert tuple(estimate.twist) == pytest.approx(tuple(twist), abs=1e-12)


def test_a_pushed_chassis_turns_into_its_motion_m2() -> None:
    """From 0.5 rad, over a way of d1: tan(gamma/2) falls by e; by Runge's method over what the joint is told."""

    def rate(heading: float) -> float:
        speeds = OFFSET.wheel_speeds(Twist(1.0, 0.0, 0.0), [None, None, -heading])
        assert speeds is not None
        return -speeds[2]

    heading, h = -0.5, 0.25 / 400
    for _ in range(400):
        one = rate(heading)
        two = rate(heading + 0.5 * h * one)
        three = rate(heading + 0.5 * h * two)
        heading += h / 6.0 * (one + 2.0 * two + 2.0 * three + rate(heading + h * three))
    assert math.tan(-heading / 2.0) / math.tan(0.25) == pytest.approx(math.exp(-1.0), abs=1e-9)


@pytest.mark.parametrize(("share", "settles"), [(0.30, True), (0.39, True), (0.42, False), (0.54, False)])
def test_with_an_angle_one_cycle_old_the_loop_swings_from_ln_1_5_on(share: float, settles: bool) -> None:
    """k = 2, `share` = c h/d1: 0.4055 is the limit, though period and age together are still within 1.0986."""
    robot, correct, h, old = PulledRobot(D1, 0.02), compensation(2.0), share * D1, 0.02
    errors = []
    for _ in range(400):
        vx, vy, _ = correct.turn(-1.0, 0.0, joint=-old, path_rate=0.0, dt=h)
        old = robot.heading
        robot.move(vx, vy, h)
        errors.append(abs(robot.heading))
    assert (max(errors[-20:]) < 1e-3) is settles


def compensation(gain: float) -> Compensation:
    return Compensation(gain=gain, regions=RIGHT_ANGLE, axle_offset=D1, authority=1e9)


def figure_9() -> Path:
    """60 degrees at 5 m, 90 degrees at 8 m, 5 m straight on; 1 s at 0.5 m/s for the curvature to change between."""
    return Path(
        Pose(0.0, 0.0, 0.0),
        [
            Piece("arc", 5.0 * math.pi / 3.0, 0.2, 0.2),
            Piece("clothoid", 0.5, 0.2, 0.125),
            Piece("arc", 4.0 * math.pi, 0.125, 0.125),
            Piece("clothoid", 0.5, 0.125, 0.0),
            Piece("line", 5.0, 0.0, 0.0),
        ],
    )


def along_figure_9(gain: float, h: float) -> tuple[float, float, set[Region]]:
    """Largest error of gamma, rad, and of the position, m, and the regions the chassis was in; nothing corrects it."""
    path, speed = figure_9(), 0.5
    robot, correct = PulledRobot(D1, math.asin(0.2 * D1) - math.pi), compensation(gain)
    errors, deviations, regions = [], [], set()
    for cycle in range(int(path.length / speed / h) + 1):
        point = path.at(speed * h * cycle)
        deviations.append(math.hypot(robot.x - point.x, robot.y - point.y))
        vx, vy, pull = correct.turn(
            speed * math.cos(point.heading),
            speed * math.sin(point.heading),
            joint=-robot.heading,
            path_rate=speed * point.curvature,
            dt=h,
        )
        assert pull is not None
        errors.append(abs(pull.error))
        regions.add(pull.region)
        robot.move(vx, vy, h)
    return max(errors), max(deviations), regions


def test_figure_9_is_as_long_as_it_says() -> None:
    assert figure_9().length == pytest.approx(22.802 + 1.0, abs=5e-4)


@pytest.mark.parametrize(
    ("h", "bound", "reference"),
    [(0.001, 8e-3, 6.4e-3), (0.004, 8e-3, 7.6e-3), (0.02, 15e-3, 14.6e-3), (0.1, 50e-3, 48.2e-3)],
)
def test_arcs_are_followed_pulled_m15(h: float, bound: float, reference: float) -> None:
    error, deviation, regions = along_figure_9(2.0, h)
    assert math.degrees(error) <= 0.5
    assert deviation <= bound
    assert deviation == pytest.approx(reference, abs=0.06e-3)
    assert regions == {Region.PULL}


@pytest.mark.parametrize("h", [0.001, 0.004, 0.02, 0.1])
def test_without_compensation_the_chassis_flips_on_arcs_m16(h: float) -> None:
    assert Region.PUSH in along_figure_9(0.0, h)[2]


def hits(gain: float, hit: float, seconds: float) -> list[float]:
    """Headings, degrees, every 4 ms of section 8: back at 0.05 m/s, 0.5 m/s across from 10 s and, reversed, from 22 s.

    The hit comes behind the compensation, which does not know of it.
    """
    robot, correct, h, headings = PulledRobot(D1, 0.0), compensation(gain), 0.004, []
    for cycle in range(round(seconds / h)):
        vx, vy, _ = correct.turn(-0.05, 0.0, joint=-robot.heading, path_rate=0.0, dt=h)
        for start, across in ((10.0, 0.5), (22.0, -0.5)):
            if round(start / h) <= cycle < round((start + hit) / h):
                vy += across
        robot.move(vx, vy, h)
        headings.append(math.degrees(robot.heading))
    return headings


def at(headings: list[float], seconds: float) -> float:
    return abs(headings[round(seconds / 0.004) - 1])


@pytest.mark.parametrize(("seconds", "degrees"), [(10.4, 64.8), (15.0, 144.3), (22.0, 176.7)])
def test_hits_without_compensation_m18(seconds: float, degrees: float) -> None:
    assert at(hits(0.0, 0.4, seconds), seconds) == pytest.approx(degrees, abs=0.06)


def test_hits_with_compensation_m19() -> None:
    headings = hits(2.0, 0.8, 30.0)
    figures = {10.8: 77.8, 15.0: 21.5, 22.0: 1.94, 22.8: 77.6, 30.0: 7.7}
    for seconds, degrees in figures.items():
        assert at(headings, seconds) == pytest.approx(degrees, abs=0.06)
    signs = [math.copysign(1.0, headings[round(seconds / 0.004) - 1]) for seconds in figures]
    assert signs in ([1, 1, 1, -1, -1], [-1, -1, -1, 1, 1])


def test_the_decay_after_a_hit_is_the_closed_form_m19() -> None:
    """tan(e/2) falls by e^(-c t/d1), 2.9 s."""
    headings = hits(2.0, 0.8, 20.0)
    before, after = (math.tan(math.radians(at(headings, seconds)) / 2.0) for seconds in (11.0, 13.9))
    assert after / before == pytest.approx(math.exp(-1.0), rel=2e-3)
