"""From repeated courses to the growth of the odometry's covariance, each number with its interval, or to why not.

How this works
--------------
The error of an end is taken for a draw from the covariance that the odometry would tell there plus that of measuring,
and the three growths are those under which all draws are likeliest. A growth below what measuring resolves, or that
these courses hardly raise, is left as the file has it. Errors that are alike in every repetition are no chance: they
are the geometry's, and no covariance makes them right. Where wheels slipped unnoticed on these courses, that is in it.
"""

from collections.abc import Sequence
from math import ceil
from typing import Final, NamedTuple

import numpy as np

from gateway.config import RobotConfig
from gateway.setup.courses import CourseError, Courses, in_words
from replay.calibrate.fitting import DOUBT
from replay.calibrate.likelihood import Consistency, Grown, Spread, consistency, likeliest, systematic
from replay.calibrate.ways import Array, Driven, mapping, off, steps, tape_noise, traced

KEYS: Final = ("variance_per_metre", "heading_variance_per_radian", "heading_variance_per_metre")
UNITS: Final = ("m^2/m", "rad^2/rad", "rad^2/m")
FACTOR: Final = 3.0  # by which an interval may reach either way
LEAST: Final = 20  # courses: of fewer draws now and then one growth passes for another
HOPELESS: Final = 200  # more of them nobody drives


class Growth(NamedTuple):
    """One number of the robot file: within `low` to `high` with 95 %."""

    key: str
    old: float
    value: float
    low: float
    high: float
    unit: str


class Untold(NamedTuple):
    """One that these courses do not tell. `more`: courses like these that it would take; None: they never will."""

    key: str
    reason: str
    more: int | None


class Judged(NamedTuple):
    """`before`, `after`: whether errors were as likely as the covariance says, by the file and by what is found."""

    growths: list[Growth]
    untold: list[Untold]
    before: Consistency
    after: Consistency
    courses: int


def judged(config: RobotConfig, courses: Courses, driven: Sequence[Driven]) -> Judged:
    """Raises CourseError where nothing can be said at all."""
    if len(driven) < LEAST:
        raise CourseError(f"{len(driven)} courses: {LEAST - len(driven)} more at least, to tell chance from chance")
    spreads = [_spread(config, courses, one) for one in driven]
    old = np.array(config.odometry.growth())
    found = likeliest(spreads, old, FACTOR)
    _refuse_systematic(spreads, np.array([one.value for one in found]))
    growths = [
        Growth(key, float(before), one.value, one.low, one.high, unit)
        for key, before, one, unit in zip(KEYS, old, found, UNITS, strict=True)
        if one.low is not None and one.high is not None
    ]
    untold = [_untold(key, one, len(driven)) for key, one in zip(KEYS, found, strict=True) if one.low is None]
    if not growths:
        raise CourseError(in_words({one.key: one.reason for one in untold}))
    after = np.array([before if one.low is None else one.value for before, one in zip(old, found, strict=True)])
    return Judged(growths, untold, consistency(spreads, old), consistency(spreads, after), len(driven))


def _spread(config: RobotConfig, courses: Courses, one: Driven) -> Spread:
    kinematics = config.robot.kinematics()
    trace = traced(steps(one.angles, mapping(kinematics), kinematics.steered), config.robot.SIDEWAYS)
    known = np.isfinite(one.end)
    square = np.ix_(known, known)
    grown = np.array([part[square] for part in trace.grown])
    kind = f"{one.course.course.value} of {one.course.length:g} m"
    return Spread(off(one.end, trace.end)[known], kind, tape_noise(courses, trace.end)[square], grown)


def _untold(key: str, found: Grown, count: int) -> Untold:
    """What tells it goes with how many courses there are."""
    more = ceil(count / max(found.short, 1e-6)) - count
    if more > HOPELESS:
        return Untold(key, "it is lost in what measuring and the other two make: longer courses may tell it", None)
    more = max(1, more)
    return Untold(key, f"not to a factor of {FACTOR:g} either way: about {more} more courses like these tell it", more)


def _refuse_systematic(spreads: Sequence[Spread], growths: Array) -> None:
    """Raises CourseError."""
    found = systematic(spreads, growths)
    if found is not None and found[1] < DOUBT:
        raise CourseError(
            f"the errors of {found[0]} are alike each time (by chance {found[1]:.1g}): that is the geometry, no "
            "chance; first `drivegate setup calibrate`"
        )
