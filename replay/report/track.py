"""The path of a drive from above, in memory that does not grow with it."""

from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

FINEST = 1e-3  # m: what nobody sees
MOST_POINTS = 6000


class Station(NamedTuple):
    """Where the robot was: m and rad; `joint`: angle by which the body is turned on its chassis; and its mode."""

    x: float
    y: float
    theta: float
    joint: float
    mode: str


class Track:
    """Takes the pose of every cycle, and keeps those that a line needs.

    `distance`: m along the path, in steps of a millimetre, so that a robot that stands and trembles goes nowhere.
    `within`: m, no pose lies further from a kept one. `pieces`: what was driven without a gap.
    """

    def __init__(self) -> None:
        self.distance = 0.0
        self.within = FINEST
        self.pieces: list[list[Station]] = []
        self._mark: Station | None = None  # of the distance
        self._last: Station | None = None
        self._kept = 0

    def add(self, here: Station) -> None:
        """The next cycle."""
        if self._mark is None or self._last is None:
            self.pieces.append([here])
            self._mark = self._last = here
            self._kept += 1
            return
        step = apart(self._mark, here)
        if step >= FINEST:
            self.distance += step
            self._mark = here
        kept = self.pieces[-1][-1]
        if here.mode != kept.mode or apart(kept, here) >= self.within:
            self._keep(here)
        self._last = here

    def part(self) -> None:
        """It ends here: what follows, if anything, does not go on from here."""
        if self._last is not None and self.pieces[-1][-1] != self._last:
            self._keep(self._last)
        self._mark = self._last = None

    def _keep(self, here: Station) -> None:
        self.pieces[-1].append(here)
        self._kept += 1
        if self._kept <= 2 * MOST_POINTS:
            return
        while self._kept > MOST_POINTS and self._kept > 2 * len(self.pieces):
            self.within *= 2.0
            self.pieces = [thinned(piece, self.within) for piece in self.pieces]
            self._kept = sum(map(len, self.pieces))


def thinned(piece: Sequence[Station], step: float) -> list[Station]:
    """Of some stations the first, each that is a step from the one before, and the last."""
    kept = [piece[0]]
    kept += [here for here in piece[1:-1] if apart(kept[-1], here) >= step]
    return [*kept, *piece[1:][-1:]]


def apart(one: Station, other: Station) -> float:
    """m."""
    return hypot(other.x - one.x, other.y - one.y)
