"""The parameters of a plant by least squares, each with its interval, and which of them a drive does not tell.

How this works
--------------
The torques that the motors told, less those that the plant needs for the motion that was measured, are the residuals.
SciPy makes their squares least. What is left over is not white (what a plant does not have comes back in the same
places), so intervals go by its sums over pieces of `PIECE_S` each (a sandwich of clusters; Liang and Zeger 1986), with
Student's t for as many pieces as there are. A parameter is told by a drive if its interval is narrower than it is
large, or than what a joint would notice; of those that are not, the worst is held at what the robot file says, and the
others are sought anew, until all that are left are told.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

Array = NDArray[np.float64]

PIECE_S = 1.0
CONFIDENCE = 0.95
WIDEST = 0.5  # half the interval, of the parameter
TWINS = 0.95  # correlation from which two parameters cannot be told apart
ROUNDS = 5  # of weighing by what is left over
MAD = 1.4826  # times the median of absolute residuals is their spread, if they are normal
FAR_OUT = 3.0  # in spreads
IMPOSSIBLE = "the plant does not fit this drive: it comes out as what no robot has"
SINGULAR = 1e10  # condition of the information, each parameter in its own measure, from which it is none


class Problem(NamedTuple):
    """`columns`: N m of each motor at each instant by one of each parameter (parameters, motors, n); `rest`: without.

    `told`: N m that the motors told, NaN where none. `values`: of the robot file, `scales`: what of each is noticed at
    all, so that a parameter may be zero; `least`: below it there is no such robot.
    """

    names: Sequence[str]
    values: Array
    scales: Array
    least: Array
    columns: Array
    rest: Array
    told: Array
    times: Array
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
            refused[name] = reasons(name, _twin(problem, free, worst, covariance))
            free.pop(worst)
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
    known = np.isfinite(problem.told)
    places, values = list(free), problem.values.copy()
    if not places:
        return values, np.empty((0, 0)), 1
    scales = problem.scales[places]

    def whole(part: Array) -> Array:
        found = values.copy()
        found[places] = part * scales
        return found

    def left(part: Array) -> Array:
        every = whole(part)
        return np.asarray((_model(problem, every) - problem.told * _scale(problem, every))[known])

    columns = np.array([(_column(problem, at) * problem.scales[at])[known] for at in places]).T
    motors = np.broadcast_to(np.arange(len(problem.told))[:, None], problem.told.shape)[known]
    part, weights = values[places] / scales, np.ones(len(columns))
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        part = least_squares(
            lambda one, root=root: root * left(one), part, lambda _, root=root: root[:, None] * columns, x_scale="jac"
        ).x
        weights = _weights(left(part), motors)
    pieces = np.floor(problem.times / PIECE_S).astype(int)
    piece = np.broadcast_to(pieces, problem.told.shape)[known]
    scores = weights[:, None] * columns * left(part)[:, None]
    sums = np.array([np.sum(scores[piece == one], axis=0) for one in np.unique(piece)])
    information = columns.T @ (weights[:, None] * columns)
    covariance = _sandwich(information, sums)
    return whole(part), covariance * np.outer(scales, scales), len(sums)


def _weights(left: Array, motors: NDArray[np.int_]) -> Array:
    """Of each residual: by the spread of its motor, and less where it is far out (Huber 1964)."""
    found = np.empty(len(left))
    for motor in np.unique(motors):
        own = np.abs(left[motors == motor])
        spread = max(MAD * float(np.median(own)), 1e-9)
        found[motors == motor] = 1.0 / (spread * spread * np.maximum(1.0, own / (FAR_OUT * spread)))
    return found


def _sandwich(information: Array, sums: Array) -> Array:
    """Covariance; infinite where nothing is known."""
    sizes = np.sqrt(np.diag(information))
    if np.any(sizes == 0.0):
        return np.diag(np.where(sizes == 0.0, np.inf, 0.0))
    scaled = information / np.outer(sizes, sizes)
    if np.linalg.cond(scaled) > SINGULAR:
        vector = np.linalg.eigh(scaled)[1][:, 0] / sizes
        return np.outer(vector, vector) * 1e30
    bread = np.linalg.inv(scaled) / np.outer(sizes, sizes)
    return np.asarray(len(sums) / max(len(sums) - 1, 1) * bread @ (sums.T @ sums) @ bread)


def _model(problem: Problem, values: Array) -> Array:
    linear = [at for at, name in enumerate(problem.names) if name != problem.scale_of_torques]
    return np.asarray(problem.rest + np.tensordot(values[linear], problem.columns[linear], axes=1))


def _column(problem: Problem, at: int) -> Array:
    return -problem.told if problem.names[at] == problem.scale_of_torques else problem.columns[at]


def _scale(problem: Problem, values: Array) -> float:
    if problem.scale_of_torques is None:
        return 1.0
    return float(values[list(problem.names).index(problem.scale_of_torques)])


def _twin(problem: Problem, free: Sequence[int], at: int, covariance: Array) -> str | None:
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    alike = np.abs(covariance[at] / (spread * spread[at]))
    alike[at] = 0.0
    other = int(np.argmax(alike))
    return problem.names[free[other]] if alike[other] >= TWINS else None
