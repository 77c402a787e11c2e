"""How a motor answers its torque: inertia, friction and delay by least squares over what was told and measured.

How this works
--------------
    inertia d(speed)/dt = torque(t - delay) - friction speed - drag, held at rest by the drag

is solved along the torques that were told, each held until the next, and where it turned by then is compared with the
position measured in each cycle, which is told in finer steps than the speed, and with no filter. SciPy makes the
squares of the difference least (output error, so noise in what is measured shifts nothing; Ljung, System
Identification, 1999, 10.2). Then the speed that was told is compared with that of the model: by how much it is told
later is a delay for the speed loop, too. A speed that is cut to whole steps is too small by a part of one, so that much
is free. What is left over is not white, so intervals go by its sums over pieces of PIECE_S (a sandwich of clusters;
Liang and Zeger 1986), with Student's t.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from replay.identify.fit import CONFIDENCE, Array

STEP_S = 0.001  # of the solution
PIECE_S = 0.1
LEAST_TIME = 1.0  # s
LONGEST_DELAY = 0.05  # s
FIRST_DELAY = 0.003
EARLIEST_SPEED = 0.005  # s, by which a speed may be told before the position
LEAST_EXPLAINED = 0.9  # of the variance of the speed
WIDEST_INERTIA = 0.15  # half the interval, of the inertia
WIDEST_DELAY = 0.003  # half the interval, s
LATE = 4.0  # usual cycles, from which one is told to have been late
SINGULAR = 1e4  # condition of what the parameters do, each in its own measure, from which they are not told apart
_HARDER = "raise speed_loop.kp of the robot file, and try again; or does something rub, slip, or turn it?"
_HARDLY = 1e-6  # in all by a parameter of its own size; a share


class ResponseError(ValueError):
    """Why nothing can be said of how a motor answers."""


class Response(NamedTuple):
    """At the output, SI: kg m^2, N m per rad/s, N m, s."""

    inertia: float
    friction: float
    drag: float
    delay: float


class Answer(NamedTuple):
    """`halves`: half of each interval of 95 %; `explained`: share of the variance of the speed; `modelled`: rad/s."""

    response: Response
    halves: Response
    explained: float
    modelled: Array


class Fitted(NamedTuple):
    """Least squares: the parameters, half of each interval of 95 %; `singular`: some cannot be told apart."""

    values: Array
    halves: Array
    singular: bool


def identify(times: ArrayLike, positions: ArrayLike, speeds: ArrayLike, torques: ArrayLike) -> Answer:
    """From s, rad, rad/s, and N m told from then on, of a motor that rests at first. Raises ResponseError in words."""
    t, position, speed, torque = (np.asarray(one, dtype=np.float64) for one in (times, positions, speeds, torques))
    if len(t) < 3 or t[-1] - t[0] < LEAST_TIME:
        raise ResponseError(f"it moved for less than {LEAST_TIME:g} s")
    if not np.std(speed) > 0.0 or not np.any(torque):
        raise ResponseError("its speed never changed, or no torque was told")
    t, way = t - t[0], position - position[0]
    moved = _by_position(t, way, speed, torque)
    motion = Response(*map(float, moved.values[:4]))
    turning = solve(motion, t, torque)[0]
    late = _fitted(
        lambda part: (np.interp(t - part[0], t, turning) - part[1] - speed)[speed != 0.0],
        t[speed != 0.0],
        start=(0.0, 0.0),
        scales=(STEP_S, float(np.std(speed))),
        low=(-EARLIEST_SPEED, -np.inf),
        high=(LONGEST_DELAY, np.inf),
    )
    modelled = np.interp(t - late.values[0], t, turning)
    explained = 1.0 - float(np.var(modelled - speed) / np.var(speed))
    response = motion._replace(delay=motion.delay + float(late.values[0]))
    halves = Response(*map(float, moved.halves[:4]))
    halves = halves._replace(delay=halves.delay + float(late.halves[0]))
    try:
        _judge(response, halves, explained, singular=moved.singular or late.singular)
    except ResponseError as error:
        raise ResponseError(f"{error}{_busy(t)}") from None
    return Answer(response, halves, explained, modelled)


def solve(response: Response, times: Array, torques: Array) -> tuple[Array, Array]:
    """Rad/s and rad at these times, s, from rest, where each torque, N m, is told from its time on."""
    inertia, friction, drag, delay = response
    grid = np.arange(0.0, times[-1] + STEP_S, STEP_S)
    # The mean over each step of what is constant between cycles, exactly: differences of its integral.
    total = np.concatenate(([0.0], np.cumsum(torques[:-1] * np.diff(times))))
    mean = np.diff(np.interp(grid - delay, times, total, left=0.0)) / STEP_S
    speeds = np.empty(len(grid))
    speeds[0] = speed = 0.0
    decay, gain, most = _step(inertia, friction, drag)
    for at, one in enumerate(mean.tolist(), start=1):
        driven = decay * speed + gain * one
        speed = driven - max(-most, min(most, driven))
        speeds[at] = speed
    ways = np.concatenate(([0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * STEP_S)))
    return np.asarray(np.interp(times, grid, speeds)), np.asarray(np.interp(times, grid, ways))


def _by_position(t: Array, way: Array, speed: Array, torque: Array) -> Fitted:
    """Inertia, friction, drag, delay, and the part of a step of the encoder by which the first position is off.

    From what fits the speed, which is convex enough to be found from anywhere.
    """
    size = float(np.std(torque)) + float(np.mean(np.abs(torque)))
    acceleration = float(np.std(np.diff(speed) / np.diff(t)))
    # What of each parameter would make all of the torque by itself.
    scales = (size / acceleration, size / float(np.max(np.abs(speed))), size, STEP_S)
    low, high = (1e-4 * scales[0], 0.0, 0.0, 0.0), (np.inf, np.inf, np.inf, LONGEST_DELAY)
    first = _fitted(
        lambda part: solve(Response(*part), t, torque)[0] - speed,
        t,
        start=(scales[0], 0.1 * scales[1], 0.3 * scales[2], FIRST_DELAY),
        scales=scales,
        low=low,
        high=high,
    )
    return _fitted(
        lambda part: solve(Response(*part[:4]), t, torque)[1] + part[4] - way,
        t,
        start=(*first.values, 0.0),
        scales=(*scales, float(np.std(way))),
        low=(*low, -np.inf),
        high=(*high, np.inf),
    )


def _fitted(
    left: Callable[[Array], Array],
    t: Array,
    *,
    start: tuple[float, ...],
    scales: tuple[float, ...],
    low: tuple[float, ...],
    high: tuple[float, ...],
) -> Fitted:
    """`left`: what the model is off by, at the times `t`; `scales`: of the parameters."""
    unit = np.asarray(scales)
    bounds = (np.asarray(low) / unit, np.asarray(high) / unit)
    found = least_squares(
        lambda part: left(part * unit), np.asarray(start) / unit, bounds=bounds, x_scale="jac", diff_step=1e-3
    )
    if _singular(found.jac):
        return Fitted(found.x * unit, np.full(len(unit), np.inf), singular=True)
    return Fitted(found.x * unit, _halves(found.jac, left(found.x * unit), t) * unit, singular=False)


def _step(inertia: float, friction: float, drag: float) -> tuple[float, float, float]:
    """Exact over a step of a constant torque: what is left of the speed, rad/s per N m, and what the drag takes."""
    rate = friction * STEP_S / inertia
    share = -np.expm1(-rate) / rate if rate > _HARDLY else 1.0
    gain = share * STEP_S / inertia
    return float(np.exp(-rate)), float(gain), float(drag * gain)


def _singular(jacobian: Array) -> bool:
    """Whether some parameters do together what others do, or one does nothing."""
    sizes = np.linalg.norm(jacobian, axis=0)
    return bool(np.any(sizes < _HARDLY) or np.linalg.cond(jacobian / sizes) > SINGULAR)


def _halves(jacobian: Array, rest: Array, t: Array) -> Array:
    """Half of each interval, in the measure of the jacobian."""
    bread = np.linalg.inv(jacobian.T @ jacobian)
    pieces: NDArray[np.int_] = np.floor(t / PIECE_S).astype(int)
    scores = jacobian * rest[:, None]
    sums = np.asarray([np.sum(scores[pieces == one], axis=0) for one in np.unique(pieces)])
    freedom = len(sums) - jacobian.shape[1]
    spread = np.sqrt(np.diag(len(sums) / freedom * bread @ (sums.T @ sums) @ bread))
    return np.asarray(student.ppf((1.0 + CONFIDENCE) / 2.0, freedom) * spread)


def _busy(t: Array) -> str:
    """Where some cycle took much longer than most, that it did."""
    cycles = np.diff(t)
    longest = float(np.max(cycles))
    return (
        f"; or was this computer busy? One cycle took {1e3 * longest:.0f} ms"
        if longest > LATE * np.median(cycles)
        else ""
    )


def _judge(response: Response, halves: Response, explained: float, *, singular: bool) -> None:
    """Raises ResponseError where the fit is bad, or the torque did not tell enough."""
    if singular:
        raise ResponseError(f"the torque had one level alone, or none of it accelerated; {_HARDER}")
    if explained < LEAST_EXPLAINED:
        raise ResponseError(
            f"inertia, friction and a delay explain {max(explained, 0.0):.0%} of how its speed changed, and "
            f"{LEAST_EXPLAINED:.0%} are needed: does something rub, slip, or turn it?"
        )
    if not halves.inertia <= WIDEST_INERTIA * response.inertia:
        raise ResponseError(
            f"its inertia is told to {halves.inertia / response.inertia:.0%} only, and {WIDEST_INERTIA:.0%} are "
            f"needed: too little of the torque went into acceleration; {_HARDER}"
        )
    if not halves.delay <= WIDEST_DELAY:
        raise ResponseError(
            f"its delay is told to {1e3 * halves.delay:.1f} ms only, and {1e3 * WIDEST_DELAY:g} ms are needed: "
            f"the steps of its torque were too soft; {_HARDER}"
        )
