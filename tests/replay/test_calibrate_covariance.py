"""Growths of the covariance from repeated courses: of odometry that errs by known chance, and every refusal."""

from collections.abc import Sequence
from math import ceil, sqrt

import numpy as np
import pytest

from gateway.config import RobotConfig, parse
from gateway.setup.courses import REPEATED, Course, CourseError, CourseName, Courses
from replay.calibrate.covariance import KEYS, Judged, judged
from replay.calibrate.likelihood import Spread, consistency, likeliest
from replay.calibrate.ways import Array, Driven, end_of, mapping, steps
from tests.replay.measured_courses import Body, tape_of
from tests.world import robot_text

TRUE = dict(zip(KEYS, (2e-4, 8e-4, 3e-5), strict=True))
COURSE = Course(course=CourseName.FORWARD, begin=0, end=1)


@pytest.fixture(scope="module")
def config() -> RobotConfig:
    return parse(robot_text("omni4"), "omni4")


@pytest.fixture(scope="module")
def runs(config: RobotConfig) -> list[Driven]:
    """Four kinds of courses without any error."""
    body = Body(config, config.robot)
    return [body.drive(place, name, 4.0) for place, name in enumerate(REPEATED)]


def erring(
    config: RobotConfig, one: Driven, rng: np.random.Generator, growths: Sequence[float], bias: float = 0.0
) -> Driven:
    """The same, the body having gone another way than the wheels say: white noise, step by step, and a bias."""
    kinematics = config.robot.kinematics()
    way = steps(one.angles, mapping(kinematics), kinematics.steered)
    forward, side, turned = np.abs(way)
    by_position, by_turning, by_driving = growths
    across = np.sqrt(by_position * (forward + side))
    about = np.sqrt(by_turning * turned + by_driving * (forward + side))
    noise = np.array([across, across, about]) * rng.normal(size=way.shape)
    biased = way * np.array([[1.0], [1.0], [1.0 + bias]]) + np.outer([0.0, 0.0, bias], forward + side)
    end: Array = end_of(biased + noise)
    return one._replace(end=tape_of(courses(config), end, rng))


def courses(config: RobotConfig) -> Courses:
    return Courses(robot=config.robot.name, course=[COURSE])


def found_in(config: RobotConfig, runs: Sequence[Driven], times: int, seed: int, bias: float = 0.0) -> Judged:
    rng = np.random.default_rng(seed)
    every = [erring(config, one, rng, tuple(TRUE.values()), bias) for one in [*runs] * times]
    return judged(config, courses(config), every)


def test_intervals_hold_the_truth_as_often_as_they_say(config: RobotConfig, runs: Sequence[Driven]) -> None:
    told = [one for seed in range(40) for one in found_in(config, runs, 10, seed).growths]
    held = [one.low <= TRUE[one.key] <= one.high for one in told]
    assert len(told) > 90
    assert 0.90 < np.mean(held) < 0.99


def test_consistency_is_told_before_and_after(config: RobotConfig, runs: Sequence[Driven]) -> None:
    cautious = config.odometry.model_copy(update=dict.fromkeys(KEYS, 4e-3))
    before = config.model_copy(update={"odometry": cautious})
    found = found_in(before, runs, 12, seed=3)
    assert found.before.nees < found.before.low
    assert found.after.low < found.after.nees < found.after.high
    sure = config.odometry.model_copy(update=dict.fromkeys(KEYS, 1e-6))
    found = found_in(config.model_copy(update={"odometry": sure}), runs, 12, seed=3)
    assert found.before.nees > found.before.high


def test_too_few_courses_are_refused(config: RobotConfig, runs: Sequence[Driven]) -> None:
    with pytest.raises(CourseError, match=r"8 courses: 12 more at least"):
        found_in(config, runs, 2, seed=1)


def test_how_many_more_courses_it_would_take(config: RobotConfig, runs: Sequence[Driven]) -> None:
    """So many, and half as many again, tell it."""
    few = found_in(config, runs, 5, seed=2)
    more = [one.more for one in few.untold if one.more is not None]
    assert more
    assert all(f"about {one.more} more courses like these tell it" in one.reason for one in few.untold)
    assert not found_in(config, runs, 5 + ceil(1.5 * max(more) / len(runs)), seed=2).untold


def test_what_measuring_hides_is_refused(config: RobotConfig) -> None:
    """Steps of 30 cm, and a tape that is good for 10."""
    step = Body(config, config.robot).drive(0, CourseName.FORWARD, 0.3)
    rng = np.random.default_rng(1)
    every = [erring(config, step, rng, tuple(TRUE.values())) for _ in range(20)]
    with pytest.raises(CourseError, match=r"^variance_per_metre, heading_.*: it is lost in what measuring"):
        judged(config, courses(config).model_copy(update={"tape": 0.1, "angle": 0.2}), every)


def test_what_a_course_does_not_raise_is_left(config: RobotConfig, runs: Sequence[Driven]) -> None:
    """Squares without a turn: nothing tells what a radian does."""
    found = found_in(config, runs[:2], 30, seed=4)
    (untold,) = [one for one in found.untold if one.key == "heading_variance_per_radian"]
    assert untold.more is None
    assert "longer courses" in untold.reason


def test_errors_that_are_alike_each_time_are_refused(config: RobotConfig, runs: Sequence[Driven]) -> None:
    with pytest.raises(CourseError, match=r"are alike each time .*first `drivegate setup calibrate`"):
        found_in(config, runs, 6, seed=5, bias=0.05)


def test_the_likeliest_variance_is_the_mean_square() -> None:
    """A closed form: errors of one number with variance g each; the profile of -2 log L is n (log g + s/g)."""
    rng = np.random.default_rng(6)
    off = rng.normal(0.0, [sqrt(3e-4), 1.0], (60, 2))
    kinds = np.array([np.diag([1.0, 0.0]), np.diag([0.0, 1.0])])
    spreads = [Spread(one, "line", np.zeros((2, 2)), kinds) for one in off]
    both = likeliest(spreads, np.array([1e-3, 0.5]), 3.0)
    squares = np.mean(off * off, axis=0)
    for found, square in zip(both, squares, strict=True):
        assert found.value == pytest.approx(square, rel=1e-3)
        for bound in (found.low, found.high):
            assert bound is not None
            deviance = 60.0 * (np.log(bound / square) + square / bound - 1.0)
            assert deviance == pytest.approx(3.8415, rel=0.02)
    told = consistency(spreads, squares)
    assert told.nees == pytest.approx(2.0)
    assert told.low < 2.0 < told.high
