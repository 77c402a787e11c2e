"""From what the motors told to instants at which motion and torques are both known.

How this works
--------------
A change of speed cannot be seen in noise and steps; its mean over a while can. So both sides of the equation of motion,
torques told and torques needed, are weighed with the same hump of `HALF_S` to either side before they are compared:
what the hump takes away it takes away on both sides, and for the changes of speed it is as if the hump itself had been
differentiated (the weak form of the equation). Where torques are told too seldom for that, each stands for itself
against what was needed around its instant, with a hump of fourth order that takes away less.
Instants at which wheels slip are left out: what the floor does to them is in no equation of this room.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay.identify.measured import Series
from replay.identify.models import Motion
from replay.identify.parameters import IdentifyError

Array = NDArray[np.float64]

GRID_S = 0.001
HALF_S = 0.05  # of the hump, to either side, where torques are dense
SPARSE_HALF_S = 0.05
DENSE_S = 0.012  # between two torques, at most, of dense ones
GAP_S = 0.03  # between two measurements of a speed, beyond which nobody knows what was between
SLIP = 0.05  # m/s at the rim beyond which a wheel slips and does not only creep
LEAST_RATE = 0.1  # rad/s below which no wheel turns
SAME_S = 1e-5  # in which two torques are told at the same instant
LONGEST_S = 300.0  # of a drive that are looked at


class Moments(NamedTuple):
    """`motion`: on a fine grid. `at`: s, the instants. `told`: N m of each motor there (motors, n), NaN where none.

    `slipping`: instants left out for that.
    """

    motion: Motion
    at: Array
    told: Array
    slipping: int
    hump: Array

    @property
    def sparse(self) -> bool:
        """Whether each torque stands for itself."""
        return bool(np.any(self.hump < 0.0))

    def abrupt(self, fine: Array) -> Array:
        """How much it matters at each instant how wide the hump is: what a torque told there cannot be held against."""
        wider = self._replace(hump=_hump(SPARSE_HALF_S, fourth=False))
        return np.abs(wider.weighed(fine) - self.weighed(fine))

    def without(self, left_out: NDArray[np.bool_]) -> "Moments":
        """Without these instants."""
        return self._replace(at=self.at[~left_out], told=self.told[:, ~left_out])

    def weighed(self, fine: Array) -> Array:
        """Of numbers on the fine grid (..., grid) what the hump makes of them at the instants (..., n)."""
        flat = fine.reshape(-1, fine.shape[-1])
        found = [np.interp(self.at, self.motion.times, np.convolve(row, self.hump, mode="same")) for row in flat]
        return np.array(found).reshape(*fine.shape[:-1], len(self.at))


def moments(series: Sequence[Series], rows: Array, radius: float, like: Moments | None = None) -> Moments:
    """Of a drive. `rows`: joint rates = rows @ speeds; `radius`: m, of the wheels. Raises IdentifyError.

    `like`: at the instants of another drive of the same course.
    """
    silent = [one.name for one in series if not one.torques.size]
    if silent:
        raise IdentifyError(f"{', '.join(silent)}: no torque was told, and without it nothing is known")
    dense = all(one.torques.size > 1 and float(np.median(np.diff(one.torque_times))) <= DENSE_S for one in series)
    if not dense and len(series) > rows.shape[1]:
        raise IdentifyError(
            f"torques are told less often than every {DENSE_S * 1e3:g} ms: more than three wheels share what is asked "
            "of them as they like, so that all torques of an instant are needed"
        )
    begin, end = _moving(series) if like is None else _ends(like)
    nodes = np.arange(begin, end, GRID_S)
    back = np.linalg.pinv(rows)
    rates = np.array([np.interp(nodes, one.times, one.rates) for one in series])
    speeds = back @ rates
    times, middle = (nodes[1:] + nodes[:-1]) / 2.0, (speeds[:, 1:] + speeds[:, :-1]) / 2.0
    motion = Motion(times, middle, np.diff(speeds) / GRID_S, rows @ middle)
    half = HALF_S if dense else SPARSE_HALF_S
    if like is not None:
        at = like.at
    else:
        at = np.arange(begin + half, end - half, half) if dense else _instants(series, begin + half, end - half)
    found = Moments(motion, at, np.empty((0, 0)), 0, _hump(half, fourth=not dense))
    off = found.weighed(np.array([np.interp(times, nodes, row) for row in rates - rows @ speeds]))
    slipping = np.any(np.abs(off) * radius > SLIP, axis=0)
    known = found.weighed(_unknown(series, times)) < 1e-9
    told = np.array([found.weighed(_between(one, times)) if dense else _own(one, at) for one in series])
    if like is not None:
        return found._replace(told=told)
    kept = known & ~slipping & np.any(np.isfinite(told), axis=0)
    if np.count_nonzero(kept) < 2:
        raise IdentifyError("there is hardly an instant at which speeds and torques are both known and no wheel slips")
    return found._replace(at=at[kept], told=told[:, kept], slipping=int(np.count_nonzero(slipping)))


def _moving(series: Sequence[Series]) -> tuple[float, float]:
    """From when on and until when something turns. Raises IdentifyError."""
    turning = [one.times[np.abs(one.rates) > LEAST_RATE] for one in series]
    turning = [times for times in turning if times.size]
    if not turning:
        raise IdentifyError("the robot stood still: nothing can be learnt from that")
    begin, end = min(times[0] for times in turning) - 0.2, max(times[-1] for times in turning) + 0.2
    begin = max(begin, *(one.times[0] for one in series))
    return float(begin), float(min(end, begin + LONGEST_S, *(one.times[-1] for one in series)))


def _ends(like: Moments) -> tuple[float, float]:
    times = like.motion.times
    return float(times[0] - GRID_S / 2.0), float(times[-1] + GRID_S)


def _hump(half: float, *, fourth: bool) -> Array:
    x = np.arange(-half, half + GRID_S / 2.0, GRID_S) / half
    weights = (1.0 - x * x) * ((3.0 - 7.0 * x * x) if fourth else 1.0)
    return weights / np.sum(weights)


def _instants(series: Sequence[Series], begin: float, end: float) -> Array:
    times = np.unique(np.concatenate([one.torque_times for one in series]))
    return times[(times >= begin) & (times <= end)]


def _unknown(series: Sequence[Series], times: Array) -> Array:
    """1 where some motor was silent for too long, 0 elsewhere."""
    found = np.zeros(len(times))
    for one in series:
        places = np.clip(np.searchsorted(one.times, times), 1, len(one.times) - 1)
        found[(one.times[places] - one.times[places - 1]) > GAP_S] = 1.0
    return found


def _between(one: Series, times: Array) -> Array:
    return np.interp(times, one.torque_times, one.torques)


def _own(one: Series, at: Array) -> Array:
    """Only where it told a torque, to half a ms: told again on the same course, its clock is the same."""
    places = np.clip(np.searchsorted(one.torque_times, at), 1, len(one.torque_times) - 1)
    places -= at - one.torque_times[places - 1] < one.torque_times[places] - at
    return np.where(np.abs(one.torque_times[places] - at) < SAME_S, one.torques[places], np.nan)
