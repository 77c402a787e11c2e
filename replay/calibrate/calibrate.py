"""From measured courses to the geometry of a robot file, each number with its interval, or to why not."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import RobotConfig
from gateway.kinematics.contract import GeometryError
from gateway.setup.courses import CourseError, CourseName, Courses, in_words
from replay.calibrate.fitting import (
    DOUBT,
    LEAST_SPARE,
    End,
    Fit,
    NoFitError,
    Solved,
    Untold,
    derivative,
    quantile,
    solved,
)
from replay.calibrate.models import Model, Number, Told, model_of
from replay.calibrate.umbmark import Umbmark, umbmark
from replay.calibrate.ways import Array, Driven, end_of, off, tape_noise, traced

SHARE: Final = 0.01  # of a number, that lies in what courses do not tell: more, and it is not told


class Refused(NamedTuple):
    """A number that these courses do not tell."""

    name: str
    reason: str


class Calibrated(NamedTuple):
    """`before`, `after`: rms of measured less told ends, m and rad, by the file as it was and as it is found.

    `chance`: of what the odometry says of itself, that showed; `squares`: where some were driven both ways.
    """

    numbers: list[Number]
    told: list[Told]
    refused: list[Refused]
    before: tuple[float, float]
    after: tuple[float, float]
    chance: float
    spare: int
    squares: Umbmark | None
    squares_after: Umbmark | None


def calibrated(config: RobotConfig, courses: Courses, driven: Sequence[Driven]) -> Calibrated:
    """Raises CourseError where nothing can be said at all."""
    model = model_of(config.robot, driven)
    _check_spare(driven, 1 if model.optional else len(model.start))
    free, refused, (values, fit) = _best(config, courses, model, driven)
    _refuse_misfits(courses, model, driven, values, fit)
    covariance = np.zeros((len(model.start),) * 2)
    covariance[np.ix_(free, free)] = fit.covariance
    numbers = model.numbers(values, covariance, quantile(fit.spare))
    refused |= _wide(numbers)
    return Calibrated(
        [one for one in numbers if one.name not in refused],
        model.told(values, covariance, quantile(fit.spare)),
        [Refused(*one) for one in refused.items()],
        _left(model, driven, model.start),
        _left(model, driven, values),
        fit.chance,
        fit.spare,
        _squares(config, model, driven, model.start),
        _squares(config, model, driven, values),
    )


def _best(
    config: RobotConfig, courses: Courses, model: Model, driven: Sequence[Driven]
) -> tuple[list[int], dict[str, str], Solved]:
    """Places of the numbers that are told, reasons of those that are not, and all values. Raises CourseError."""
    free, refused = list(range(len(model.start))), dict[str, str]()
    while True:
        found = _Search(config, courses, model, free).solved(driven)
        if isinstance(found, Solved):
            return free, refused, found
        untold = _untold(model, free, found)
        refused |= {model.names[at]: reason for at, reason in untold.items()}
        free = [at for at in free if at not in untold]
        if not model.optional or not free:
            raise CourseError(in_words(refused))


class _Search:
    """For those numbers of a model that are free; the others are as the file has them."""

    def __init__(self, config: RobotConfig, courses: Courses, model: Model, free: Sequence[int]) -> None:
        self._growth = np.array(config.odometry.growth())
        self._sideways = config.robot.SIDEWAYS
        self._courses = courses
        self._model = model
        self._free = list(free)

    def solved(self, driven: Sequence[Driven]) -> Solved | Untold:
        """All values. Raises CourseError."""
        start, scales = self._model.start[self._free], self._model.scales[self._free]
        try:
            found = solved(lambda part: [self._end(one, part, scales) for one in driven], start, scales)
        except (NoFitError, GeometryError) as error:
            raise CourseError(str(error)) from None
        return found if isinstance(found, Untold) else found._replace(values=self._whole(found.values))

    def _whole(self, part: Array) -> Array:
        found = self._model.start.copy()
        found[self._free] = part
        return found

    def _end(self, one: Driven, part: Array, scales: Array) -> End:
        """What of it was measured."""
        trace = traced(self._model.way(one, self._whole(part)), self._sideways)
        known = np.isfinite(one.end)
        square = np.ix_(known, known)
        by = derivative(lambda at: end_of(self._model.way(one, self._whole(at))), part, scales)
        return End(
            off(one.end, trace.end)[known],
            by[known],
            tape_noise(self._courses, trace.end)[square],
            np.tensordot(self._growth, trace.grown, axes=1)[square],
        )


def _untold(model: Model, free: Sequence[int], found: Untold) -> dict[int, str]:
    """Those that are not told, and why."""
    mixed = [at for at, share in zip(free, found.share, strict=True) if share > SHARE]
    together = f" (only mixed with {', '.join(model.names[at] for at in mixed)})" if len(mixed) > 1 else ""
    return {at: f"these courses do not tell it{together}: {model.missing(at)}" for at in mixed}


def _wide(numbers: Sequence[Number]) -> dict[str, str]:
    """Those whose interval is too wide, and those that are written with them alone; and why."""
    wide = [one for one in numbers if one.half > one.widest]
    found = {one.name: f"goes with {wider.name}" for wider in wide for one in numbers if one.part == wider.part}
    return found | {
        one.name: f"only to +-{one.half:.2g} {one.unit}, more than {one.widest:.2g}: {one.hint}" for one in wide
    }


def _check_spare(driven: Sequence[Driven], sought: int) -> None:
    measured = sum(int(np.count_nonzero(np.isfinite(one.end))) for one in driven)
    if measured < sought + LEAST_SPARE:
        raise CourseError(
            f"{measured} numbers were measured, and {sought} are sought: at least {LEAST_SPARE} more, so that errors "
            "show: measure more courses"
        )


def _refuse_misfits(courses: Courses, model: Model, driven: Sequence[Driven], values: Array, fit: Fit) -> None:
    """Raises CourseError for ends that are not those of tape and chance."""
    if fit.odd is not None and fit.odd.doubt < DOUBT:
        one = driven[fit.odd.place]
        raise CourseError(
            f"{one.label}: does not fit the others: it ends {_words(one.end, fit.odd.off)} from where these have it "
            f"(by chance {fit.odd.doubt:.1g}): a wrong number, or a wheel slipped there"
        )
    if fit.doubt < DOUBT:
        length, turn = _left(model, driven, values)
        raise CourseError(
            f"ends are {length:.3g} m and {turn:.2g} rad (rms) from where the best geometry has them, more than tape "
            f"({courses.tape:g} m, {courses.angle:g} rad) and the odometry's own covariance explain: wheels slipped, "
            "numbers are wrong, or the chassis is no such one"
        )


def _words(end: Array, measured: Array) -> str:
    """`measured`: off, of what was."""
    kinds = [what for what, one in zip(("m in x", "m in y", "rad in turn"), end, strict=True) if np.isfinite(one)]
    return ", ".join(f"{value:+.3f} {kind}" for value, kind in zip(measured, kinds, strict=True))


def _left(model: Model, driven: Sequence[Driven], values: Array) -> tuple[float, float]:
    """Rms of measured less told, m and rad; 0 where nothing of a kind was measured."""
    every = np.array([off(one.end, end_of(model.way(one, values))) for one in driven])
    found = []
    for part in (every[:, :2], every[:, 2]):
        known = part[np.isfinite(part)]
        found.append(float(np.sqrt(np.mean(known * known))) if known.size else 0.0)
    return found[0], found[1]


def _squares(config: RobotConfig, model: Model, driven: Sequence[Driven], values: Array) -> Umbmark | None:
    """Where squares of one length were driven both ways."""
    ends: dict[CourseName, list[tuple[float, float]]] = {CourseName.SQUARE_LEFT: [], CourseName.SQUARE_RIGHT: []}
    lengths = set()
    for one in driven:
        if one.course.course in ends:
            x, y, _ = off(one.end, end_of(model.way(one, values)))
            if np.isfinite(x) and np.isfinite(y):
                ends[one.course.course].append((float(x), float(y)))
                lengths.add(one.course.length)
    if not all(ends.values()) or len(lengths) != 1:
        return None
    robot = config.robot
    track = robot.track if isinstance(robot, OffsetDifferentialRobot) else None
    return umbmark(*ends.values(), length=lengths.pop(), track=track)
