"""How much odometry errs by chance: likelihood of its growths, and whether errors are as it says.

How this works
--------------
The covariance of an end is linear in the growths, and the errors of ends are draws from it and that of measuring. The
likeliest growths are sought by their logarithms, with intervals by the profile of the likelihood, as variances of few
draws are anything but normal.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize
from scipy.stats import chi2, f

Array = NDArray[np.float64]

CONFIDENCE: Final = 0.95
RANGE: Final = 20.0  # of the logarithm of a growth, either way of what the file says
LEAST_SPARE: Final = 6  # repetitions beyond the first of each kind, from which errors alike are told from chance


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
    """Growths by maximum likelihood, from these on; `factor`: how far an interval may reach either way."""
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
    if spare < LEAST_SPARE:
        return None
    scatter = sum((some - some.mean(axis=0)).T @ (some - some.mean(axis=0)) for some in groups.values()) / spare
    found = []
    for kind, some in groups.items():
        mean = some.mean(axis=0)
        square = len(some) * float(mean @ np.linalg.solve(scatter, mean))
        found.append((kind, float(f.sf(square * (spare - 2) / (3.0 * spare), 3, spare - 2)) * len(groups)))
    return min(found, key=lambda one: one[1])
