"""Generalised least squares over the ends of measured courses.

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
from scipy.optimize import minimize_scalar
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
LEAST_SPARE: Final = 3  # numbers measured beyond those that are sought, so that errors show


class End(NamedTuple):
    """`off`: measured less told, of what was measured alone; `by`: how `told` changes with each parameter."""

    off: Array
    by: Array
    tape: Array
    chance: Array


class Odd(NamedTuple):
    """The course that fits the others least, how likely that is, and by how much it is off what they say."""

    place: int
    doubt: float
    off: Array


class Fit(NamedTuple):
    """`covariance`: of the parameters; `spare`: degrees of freedom; `chance`: q.

    `left`: squares left over, each of its own variance; `doubt`: how likely what is left over is, with q = 1.
    """

    change: Array
    covariance: Array
    spare: int
    chance: float
    left: float
    doubt: float
    odd: Odd | None = None

    @property
    def halves(self) -> Array:
        """Half of each interval."""
        return np.asarray(quantile(self.spare) * np.sqrt(np.diag(self.covariance)))


def quantile(spare: int) -> float:
    """By how many standard errors an interval reaches either way."""
    return float(student.ppf((1.0 + CONFIDENCE) / 2.0, spare))


def singular(ends: Sequence[End], scales: Array) -> Array | None:
    """How much of each parameter, 0 to 1, lies in what these ends do not tell; None: they tell all.

    That is the diagonal of the projector onto the directions without information, each parameter in its own measure.
    """
    information = _normal(_stacked(ends), 0.0)[0] * np.outer(scales, scales)
    values, vectors = np.linalg.eigh(information)
    blind = vectors[:, values * SINGULAR <= values[-1]]
    return np.asarray(np.sum(blind * blind, axis=1)) if blind.size else None


class Solved(NamedTuple):
    """Parameters, and how surely."""

    values: Array
    fit: Fit


class Untold(NamedTuple):
    """These ends do not tell all parameters; `share`: how much of each lies in what they do not tell."""

    share: Array


class NoFitError(ValueError):
    """Numbers run away."""


def solved(ends_at: Callable[[Array], Sequence[End]], start: Array, scales: Array) -> Solved | Untold:
    """Parameters and how surely. `scales`: their sizes. Raises NoFitError."""
    values = start
    for _ in range(ROUNDS):
        ends = ends_at(values)
        share = singular(ends, scales)
        if share is not None:
            return Untold(share)
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


class _Alike(NamedTuple):
    """Ends of as many numbers each, stacked."""

    off: Array
    by: Array
    tape: Array
    chance: Array


def _stacked(ends: Sequence[End]) -> list[_Alike]:
    sizes = {len(end.off) for end in ends}
    return [_Alike(*map(np.array, zip(*[end for end in ends if len(end.off) == size], strict=True))) for size in sizes]


def _normal(stacks: Sequence[_Alike], chance: float) -> tuple[Array, Array, float, float]:
    """J' V^-1 J, J' V^-1 r, r' V^-1 r, log |V|."""
    size = stacks[0].by.shape[2] + 1
    whole, volume = np.zeros((size, size)), 0.0
    for one in stacks:
        noise = one.tape + chance * one.chance
        both = np.concatenate((one.by, one.off[..., None]), axis=2)
        whole += np.einsum("nij,nik->jk", both, np.linalg.solve(noise, both))
        volume += float(np.sum(np.linalg.slogdet(noise)[1]))
    return whole[:-1, :-1], whole[:-1, -1], float(whole[-1, -1]), volume


def _fit(ends: Sequence[End]) -> Fit:
    stacks = _stacked(ends)

    def unlikelihood(root: float) -> float:
        information, pull, left, volume = _normal(stacks, root * root)
        explained = float(pull @ np.linalg.solve(information, pull))
        return volume + float(np.linalg.slogdet(information)[1]) + left - explained

    best = minimize_scalar(unlikelihood, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3})
    root = 0.0 if unlikelihood(0.0) <= best.fun else float(best.x)
    information, pull, left, _ = _normal(stacks, root * root)
    covariance: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
    spare = sum(len(end.off) for end in ends) - len(pull)
    change = np.asarray(covariance @ pull)
    return Fit(change, covariance, spare, root * root, left - float(pull @ change), _doubt(stacks, spare))


def _doubt(stacks: Sequence[_Alike], spare: int) -> float:
    information, pull, left, _ = _normal(stacks, 1.0)
    return float(chi2.sf(left - float(pull @ np.linalg.solve(information, pull)), max(spare, 1)))


def _odd(ends: Sequence[End]) -> Odd | None:
    """By all others, each left out in turn, and by their scatter where that is more than it should be."""
    size = ends[0].by.shape[1]
    sizes = np.sqrt(np.diag(np.linalg.inv(_normal(_stacked(ends), 0.0)[0])))
    found: list[Odd] = []
    for place, end in enumerate(ends):
        others = [*ends[:place], *ends[place + 1 :]]
        spare = sum(len(one.off) for one in others) - size
        if spare >= LEAST_SPARE and singular(others, sizes) is None:
            fit = _fit(others)
            off = np.asarray(end.off - end.by @ fit.change)
            noise = end.tape + fit.chance * end.chance + end.by @ fit.covariance @ end.by.T
            ratio = float(off @ np.linalg.solve(noise, off)) / (len(off) * max(1.0, fit.left / spare))
            found.append(Odd(place, min(1.0, len(ends) * float(f.sf(ratio, len(off), spare))), off))
    return min(found, key=lambda one: one.doubt, default=None)
