"""Generalised least squares over the ends of measured courses, and the likelihood of how much odometry errs by chance.

How this works
--------------
The noise of an end is V = T + q P: T of tape and marked directions, which is known, and P of what odometry errs by
chance, of which only the shape is known. q, from 0 (a perfect floor) to 1 (as much as the odometry says of itself), is
found by restricted likelihood (Patterson and Thompson 1971), the parameters by Gauss-Newton; intervals go by Student's
t. A course that does not fit the others is told by its error against what they say, each left out in turn. All ends
together are held against q = 1: what is left over must not be more than tape and chance explain (chi-square).
"""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.stats import chi2, f
from scipy.stats import t as student

Array = NDArray[np.float64]

CONFIDENCE: Final = 0.95
DOUBT: Final = 1e-3  # a chance below it is none
ROUNDS: Final = 30
CONVERGED: Final = 1e-3  # of a standard error
FAR: Final = 0.5  # of a number's size: a robot file that is so wrong was not measured at all
STEP: Final = 1e-5  # of a parameter's own size, to differentiate
SINGULAR: Final = 1e8  # condition of the information, each parameter in its own measure, from which it is none
RANGE: Final = 20.0  # of the logarithm of a growth, either way of what the file says
LEAST_SPARE: Final = 3  # numbers measured beyond those that are sought, so that errors show


class End(NamedTuple):
    """`off`: measured less told, of what was measured alone; `by`: how `told` changes with each parameter."""

    off: Array
    by: Array
    tape: Array
    chance: Array


class Fit(NamedTuple):
    """`covariance`: of the parameters; `spare`: degrees of freedom; `chance`: q.

    `doubt`: how likely what is left over is, with q = 1; `odd`: the course that fits the others least, and how likely.
    """

    change: Array
    covariance: Array
    spare: int
    chance: float
    doubt: float
    odd: tuple[int, float] | None

    @property
    def halves(self) -> Array:
        """Half of each interval."""
        return np.asarray(quantile(self.spare) * np.sqrt(np.diag(self.covariance)))


def quantile(spare: int) -> float:
    """By how many standard errors an interval reaches either way."""
    return float(student.ppf((1.0 + CONFIDENCE) / 2.0, spare))


def singular(ends: Sequence[End], scales: Array) -> Array | None:
    """The direction of parameters, each in its own measure, that these ends do not tell; None: they tell all."""
    information = _normal(ends, 0.0)[0] * np.outer(scales, scales)
    values, vectors = np.linalg.eigh(information)
    if values[0] > 0.0 and values[-1] < SINGULAR * values[0]:
        return None
    return np.asarray(vectors[:, 0])


class Solved(NamedTuple):
    """Parameters, and how surely."""

    values: Array
    fit: Fit


class Untold(NamedTuple):
    """These ends do not tell all numbers: not along this direction, each number in its own measure."""

    direction: Array


class NoFitError(ValueError):
    """Numbers run away."""


def solved(ends_at: Callable[[Array], Sequence[End]], start: Array, scales: Array) -> Solved | Untold:
    """Parameters and how surely. `scales`: their sizes. Raises NoFitError."""
    values = start
    for _ in range(ROUNDS):
        ends = ends_at(values)
        direction = singular(ends, scales)
        if direction is not None:
            return Untold(direction)
        fit = _fit(ends)
        values = values + fit.change
        if not np.all(np.abs(values - start) < FAR * scales):
            break
        if np.all(np.abs(fit.change) <= CONVERGED * np.sqrt(np.diag(fit.covariance))):
            return Solved(values, fit._replace(odd=_odd(ends)))
    raise NoFitError("no geometry near that of the robot file fits these ends")


def derivative(function: Callable[[Array], Array], at: Array, scales: Array) -> Array:
    """Central differences; a column for each parameter, last."""
    columns = []
    for place, scale in enumerate(scales):
        step = np.zeros(len(at))
        step[place] = STEP * scale
        columns.append((function(at + step) - function(at - step)) / (2.0 * STEP * scale))
    return np.stack(columns, axis=-1)


def _normal(ends: Sequence[End], chance: float) -> tuple[Array, Array, float, float]:
    """J' V^-1 J, J' V^-1 r, r' V^-1 r, log |V|."""
    size = ends[0].by.shape[1]
    information, pull, left, volume = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
    for end in ends:
        noise = end.tape + chance * end.chance
        weighed = np.linalg.solve(noise, np.column_stack((end.by, end.off)))
        information += end.by.T @ weighed[:, :-1]
        pull += end.by.T @ weighed[:, -1]
        left += float(end.off @ weighed[:, -1])
        volume += float(np.linalg.slogdet(noise)[1])
    return information, pull, left, volume


def _fit(ends: Sequence[End]) -> Fit:
    def unlikelihood(root: float) -> float:
        information, pull, left, volume = _normal(ends, root * root)
        explained = float(pull @ np.linalg.solve(information, pull))
        return volume + float(np.linalg.slogdet(information)[1]) + left - explained

    best = minimize_scalar(unlikelihood, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3})
    root = 0.0 if unlikelihood(0.0) <= best.fun else float(best.x)
    information, pull, _, _ = _normal(ends, root * root)
    covariance: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
    spare = sum(len(end.off) for end in ends) - len(pull)
    return Fit(np.asarray(covariance @ pull), covariance, spare, root * root, _doubt(ends, spare), None)


def _doubt(ends: Sequence[End], spare: int) -> float:
    information, pull, left, _ = _normal(ends, 1.0)
    return float(chi2.sf(left - float(pull @ np.linalg.solve(information, pull)), max(spare, 1)))


def _odd(ends: Sequence[End]) -> tuple[int, float] | None:
    """The course that is least likely by what the others say, and how likely, of so many; None: too few to tell."""
    size = ends[0].by.shape[1]
    found: tuple[int, float] | None = None
    for place, end in enumerate(ends):
        others = [*ends[:place], *ends[place + 1 :]]
        spare = sum(len(one.off) for one in others) - size
        if spare < LEAST_SPARE or singular(others, np.sqrt(np.diag(np.linalg.inv(_normal(ends, 0.0)[0])))) is not None:
            continue
        fit = _fit(others)
        left = end.off - end.by @ fit.change
        noise = end.tape + fit.chance * end.chance + end.by @ fit.covariance @ end.by.T
        ratio = float(left @ np.linalg.solve(noise, left)) / len(left)
        doubt = min(1.0, len(ends) * float(f.sf(ratio, len(left), spare)))
        if found is None or doubt < found[1]:
            found = place, doubt
    return found


class Spread(NamedTuple):
    """Of one repeated course: its error, its kind, and what a growth of 1 of each kind makes of its covariance."""

    off: Array
    kind: str
    tape: Array
    grown: Array  # (kinds, m, m)


class Grown(NamedTuple):
    """A growth: `low` to `high` is its interval, None: wider than asked for.

    `short`: of the deviance that its bounds would need, what they have; 1 or more: told, and it goes with the number of
    courses.
    """

    value: float
    low: float | None
    high: float | None
    short: float


def likeliest(spreads: Sequence[Spread], start: Array, factor: float) -> list[Grown]:
    """Growths by maximum likelihood, from these on; `factor`: how far an interval may reach either way.

    Intervals go by the profile of the likelihood: variances of few courses are anything but normal.
    """
    likelihood = _Likelihood([_Alike.of(some) for some in _by_size(spreads)], np.log(start))
    best = likelihood.best()
    enough = float(chi2.ppf(CONFIDENCE, 1))
    found = []
    for at, middle in enumerate(best.logs):

        def beyond(log: float, at: int = at) -> float:
            return likelihood.best(at, log, near=best.logs).least - best.least - enough

        reach = float(np.log(factor))
        least = min(beyond(middle - reach), beyond(middle + reach))
        low = high = None
        if least >= 0.0:
            low = float(np.exp(brentq(beyond, middle - reach, middle, xtol=1e-3)))
            high = float(np.exp(brentq(beyond, middle, middle + reach, xtol=1e-3)))
        found.append(Grown(float(np.exp(middle)), low, high, max(0.0, 1.0 + least / enough)))
    return found


class _Best(NamedTuple):
    """`least`: -2 log of the likelihood, but for what does not change."""

    logs: Array
    least: float


class _Likelihood:
    """Of logarithms of growths. `start`: from where they are sought."""

    def __init__(self, alike: "Sequence[_Alike]", start: Array) -> None:
        self._alike = alike
        self._start = start

    def best(self, held: int | None = None, log: float = 0.0, near: Array | None = None) -> _Best:
        """The likeliest, with one of them held there."""
        free = [at for at in range(len(self._start)) if at != held]

        def whole(part: Array) -> Array:
            found = self._start.copy()
            found[free] = part
            if held is not None:
                found[held] = log
            return found

        def unlikelihood(part: Array) -> tuple[float, Array]:
            told = [one.unlikelihood(np.exp(whole(part))) for one in self._alike]
            return sum(one[0] for one in told), np.sum([one[1] for one in told], axis=0)[free]

        tries = [self._start + shift for shift in (0.0, -3.0, 3.0)] if near is None else [near]
        bounds = [(self._start[at] - RANGE, self._start[at] + RANGE) for at in free]
        ended = [minimize(unlikelihood, one[free], jac=True, method="L-BFGS-B", bounds=bounds) for one in tries]
        found = min(ended, key=lambda one: float(one.fun))
        return _Best(whole(found.x), float(found.fun))


class _Alike(NamedTuple):
    """Spreads of as many numbers each, stacked: off (n, m), tape (n, m, m), grown (n, kinds, m, m)."""

    off: Array
    tape: Array
    grown: Array

    @classmethod
    def of(cls, spreads: Sequence[Spread]) -> "_Alike":
        return cls(*(np.array([getattr(one, name) for one in spreads]) for name in cls._fields))

    def noise(self, growths: Array) -> Array:
        """Covariance of each."""
        return np.asarray(self.tape + np.einsum("k,nkij->nij", growths, self.grown))

    def unlikelihood(self, growths: Array) -> tuple[float, Array]:
        """-2 log of it, but for what does not change; and its gradient by the logarithms."""
        noise = self.noise(growths)
        weighed = _weighed(noise, self.off)
        value = float(np.sum(np.linalg.slogdet(noise)[1]) + np.sum(self.off * weighed))
        slopes = np.einsum("nij,nkji->k", np.linalg.inv(noise), self.grown)
        slopes -= np.einsum("ni,nkij,nj->k", weighed, self.grown, weighed)
        return value, growths * slopes


def _weighed(noise: Array, off: Array) -> Array:
    return np.asarray(np.linalg.solve(noise, off[..., None])[..., 0])


def _by_size(spreads: Sequence[Spread]) -> list[list[Spread]]:
    found: dict[int, list[Spread]] = {}
    for one in spreads:
        found.setdefault(len(one.off), []).append(one)
    return list(found.values())


class Consistency(NamedTuple):
    """Normalised estimation error squared (Bar-Shalom 2001, section 5.4): the mean over the courses, of `size` numbers.

    `low` to `high`: where it lies in 95 % of cases if the covariance is right.
    """

    nees: float
    size: float
    low: float
    high: float


def consistency(spreads: Sequence[Spread], growths: Array) -> Consistency:
    """Of errors with what these growths say of them."""
    total = 0.0
    for one in map(_Alike.of, _by_size(spreads)):
        total += float(np.sum(one.off * _weighed(one.noise(growths), one.off)))
    numbers, count = sum(len(one.off) for one in spreads), len(spreads)
    low, high = chi2.ppf([(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0], numbers) / count
    return Consistency(total / count, numbers / count, float(low), float(high))


def systematic(spreads: Sequence[Spread], growths: Array) -> tuple[str, float] | None:
    """The kind of course whose errors are most alike, and how likely that is by chance (Hotelling 1931).

    None: too few of a kind to tell.
    """
    kinds: dict[str, list[Array]] = {}
    for one in spreads:
        if len(one.off) == 3:
            noise = one.tape + np.tensordot(growths, one.grown, axes=1)
            kinds.setdefault(one.kind, []).append(np.linalg.solve(np.linalg.cholesky(noise), one.off))
    groups = {kind: np.array(some) for kind, some in kinds.items() if len(some) > 1}
    spare = sum(len(some) - 1 for some in groups.values())
    if spare < 6:
        return None
    scatter = sum((some - some.mean(axis=0)).T @ (some - some.mean(axis=0)) for some in groups.values()) / spare
    found = []
    for kind, some in groups.items():
        mean = some.mean(axis=0)
        square = len(some) * float(mean @ np.linalg.solve(scatter, mean))
        found.append((kind, float(f.sf(square * (spare - 2) / (3.0 * spare), 3, spare - 2)) * len(groups)))
    return min(found, key=lambda one: one[1])
