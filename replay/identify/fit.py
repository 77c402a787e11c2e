"""The parameters of a plant by least squares, each with its interval, and which of them a drive does not tell.

How this works
--------------
The torques that the motors told, less those that the plant needs for the motion that was measured, are the residuals.
SciPy makes their squares least, those along `instruments`: noise in the motion would make every parameter smaller than
it is, and find movement where none was; the same motion without noise does not (instrumental variables; Soderstrom and
Stoica 1983). What is left over is not white, as what a plant does not have comes back in the same places. So intervals
go by its sums over pieces of `PIECE_S` each (a sandwich of clusters; Liang and Zeger 1986), with Student's t for as
many pieces as there are.

A parameter is told by a drive if its interval is narrow against it, and if what it does is not below what is left over.
Of those that are not told the worst is held at what the robot file says, and the others are sought anew, until all that
are left are told.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

Array = NDArray[np.float64]

PIECE_S = 0.5
CONFIDENCE = 0.95
WIDEST = 0.3  # half the interval, of the parameter
FAINT = 1.0  # what a parameter does (rms), of what is mostly left over
TWINS = 0.95  # cosine of the torques of two parameters from which they cannot be told apart
ROUNDS = 5  # of weighing by what is left over
MAD = 1.4826  # times the median of absolute residuals is their spread, if they are normal
FAR_OUT = 3.0  # in spreads
IMPOSSIBLE = "the plant does not fit this drive: it comes out as what no robot has"
SINGULAR = 1e10  # condition of the information, each parameter in its own measure, from which it is none
TINY = 1e-9  # N m by a parameter of its own size, in all


class Problem(NamedTuple):
    """`columns`: N m of each motor at each instant by one of each parameter (parameters, motors, n); `rest`: without.

    `told`: N m that the motors told, NaN where none. `values`: of the robot file; `scales`: what of each is noticed at
    all, so that a parameter may be zero; `least`: below it there is no such robot. `instruments`: columns as they would
    be without noise, or the same ones.
    """

    names: Sequence[str]
    values: Array
    scales: Array
    least: Array
    columns: Array
    rest: Array
    told: Array
    times: Array
    instruments: Array
    scale_of_torques: str | None  # the parameter that multiplies what was told; None: what is told is true


class Estimate(NamedTuple):
    """`half`: half of the interval."""

    value: float
    half: float


class Fit(NamedTuple):
    """`refused`: in words, by name. `model`: N m that the plant needs (motors, n)."""

    found: Mapping[str, Estimate]
    refused: Mapping[str, str]
    model: Array
    told: Array


def fit(problem: Problem, reasons: Callable[[str, str | None], str]) -> Fit:
    """`reasons`: why a drive may not tell a parameter, and with which other one it is confused (None: with none)."""
    free = list(range(len(problem.names)))
    refused: dict[str, str] = {}
    while True:
        values, covariance, pieces = _solved(problem, free)
        halves = student.ppf((1.0 + CONFIDENCE) / 2.0, max(pieces - 1, 1)) * np.sqrt(np.diag(covariance))
        sizes = np.maximum(np.abs(values[free]), problem.scales[free])
        below = [at for at, half in zip(free, halves, strict=True) if values[at] + half < problem.least[at]]
        doubt = halves / (WIDEST * sizes)
        worst = int(np.argmax(np.nan_to_num(doubt, nan=np.inf))) if free else 0
        if free and not doubt[worst] <= 1.0:
            name = problem.names[free[worst]]
            refused[name] = reasons(name, _twin(problem, free, worst))
            free.pop(worst)
        elif faint := [at for at in free if _does(problem, values, at) < FAINT]:
            name = problem.names[faint[0]]
            refused[name] = reasons(name, None)
            free.remove(faint[0])
        elif below:
            name = problem.names[below[0]]
            refused[name] = f"{IMPOSSIBLE}: {values[below[0]]:.3g}"
            free.remove(below[0])
        else:
            break
    found = {problem.names[at]: Estimate(float(values[at]), float(half)) for at, half in zip(free, halves, strict=True)}
    told = problem.told * _scale(problem, values)
    return Fit(found, refused, _model(problem, values), told)


def _solved(problem: Problem, free: Sequence[int]) -> tuple[Array, Array, int]:
    """Values of all, covariance of those that are free, number of pieces."""
    known = np.isfinite(problem.told) & np.all(np.isfinite(problem.instruments), axis=0)
    places, values = list(free), problem.values.copy()
    if not places:
        return values, np.empty((0, 0)), 1
    scales = problem.scales[places]
    columns = np.array([(_column(problem, at) * problem.scales[at])[known] for at in places]).T
    instruments = np.array([(problem.instruments[at] * problem.scales[at])[known] for at in places]).T
    motors = np.broadcast_to(np.arange(len(problem.told))[:, None], problem.told.shape)[known]

    def whole(part: Array) -> Array:
        found = values.copy()
        found[places] = part * scales
        return found

    def left(part: Array) -> Array:
        every = whole(part)
        return np.asarray((_model(problem, every) - problem.told * _scale(problem, every))[known])

    part, weights = values[places] / scales, np.ones(len(columns))
    for _ in range(ROUNDS):
        weighed = instruments * weights[:, None]
        own, information = instruments.T @ weighed, weighed.T @ columns
        if _singular(own) or _singular(information):
            return whole(part), _nothing_known(information), 1
        root = np.linalg.inv(np.linalg.cholesky(own)) @ weighed.T
        part = least_squares(lambda one, root=root: root @ left(one), part, lambda _, root=root: root @ columns).x
        weights = _weights(left(part), motors)
    pieces = np.floor(problem.times / PIECE_S).astype(int)
    piece = np.broadcast_to(pieces, problem.told.shape)[known]
    scores = weights[:, None] * instruments * left(part)[:, None]
    sums = np.array([np.sum(scores[piece == one], axis=0) for one in np.unique(piece)])
    bread = np.linalg.inv((instruments * weights[:, None]).T @ columns)
    few = len(sums) / max(len(sums) - len(places), 1)  # residuals are smaller than errors by what was fitted to them
    covariance = few * bread @ (sums.T @ sums) @ bread.T
    return whole(part), covariance * np.outer(scales, scales), len(sums)


def _weights(left: Array, motors: NDArray[np.int_]) -> Array:
    """Of each residual: by the spread of its motor, and less where it is far out (Huber 1964)."""
    found = np.empty(len(left))
    for motor in np.unique(motors):
        own = np.abs(left[motors == motor])
        spread = max(MAD * float(np.median(own)), 1e-9)
        found[motors == motor] = 1.0 / (spread * spread * np.maximum(1.0, own / (FAR_OUT * spread)))
    return found


def _singular(matrix: Array) -> bool:
    """Whether it tells less than it has rows, each in its own measure."""
    sizes = np.sqrt(np.abs(np.diag(matrix)))
    return bool(np.any(sizes < TINY) or np.linalg.cond(matrix / np.outer(sizes, sizes)) > SINGULAR)


def _nothing_known(information: Array) -> Array:
    """A covariance without bounds, along what the instants tell least of."""
    sizes = np.sqrt(np.abs(np.diag(information)))
    if np.any(sizes < TINY):
        return np.diag(np.where(sizes < TINY, np.inf, 0.0))
    vector = np.linalg.svd(information / np.outer(sizes, sizes))[2][-1] / sizes
    return np.asarray(np.outer(vector, vector) * 1e30)


def _model(problem: Problem, values: Array) -> Array:
    linear = [at for at, name in enumerate(problem.names) if name != problem.scale_of_torques]
    return np.asarray(problem.rest + np.tensordot(values[linear], problem.columns[linear], axes=1))


def _does(problem: Problem, values: Array, at: int) -> float:
    """N m that a parameter makes, of what is mostly left over, of the motor that feels it most."""
    left = np.abs(_model(problem, values) - problem.told * _scale(problem, values))
    mostly = MAD * np.nanmedian(left, axis=1)
    own = np.sqrt(np.nanmean(problem.instruments[at] ** 2, axis=1)) * max(abs(values[at]), problem.scales[at])
    return float(np.max(own / np.maximum(mostly, TINY)))


def _column(problem: Problem, at: int) -> Array:
    """By how much the residuals grow with a parameter."""
    return -problem.told if problem.names[at] == problem.scale_of_torques else problem.columns[at]


def _scale(problem: Problem, values: Array) -> float:
    if problem.scale_of_torques is None:
        return 1.0
    return float(values[list(problem.names).index(problem.scale_of_torques)])


def _twin(problem: Problem, free: Sequence[int], at: int) -> str | None:
    """The other parameter whose torques go along with those of this one."""
    known = np.isfinite(problem.told) & np.all(np.isfinite(problem.instruments), axis=0)
    columns = np.array([problem.instruments[one][known] for one in free])
    sizes = np.maximum(np.linalg.norm(columns, axis=1), TINY)
    alike = np.abs(columns @ columns[at]) / (sizes * sizes[at])
    alike[at] = 0.0
    other = int(np.argmax(alike))
    return problem.names[free[other]] if alike[other] >= TWINS else None
