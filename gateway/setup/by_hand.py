"""Recognises by its encoder which wheel a person turns, and which way. Listens only. Pure."""

from collections.abc import Collection, Iterable
from typing import Final, NamedTuple

from drivers import DRIVERS
from drivers.contract import CanFrame
from drivers.sighting import Sighting

LEAST: Final = 0.5  # rad at the output
OTHERS: Final = 0.25  # of that way, that another may go at most: wheels on the floor drag each other along
REST_NS: Final = 400_000_000  # without a move, until a turn counts as over
MOVE: Final = 0.05  # rad at the output

Kind = tuple[str, str]  # driver, variant


class Turned(NamedTuple):
    """A controller whose shaft was turned, rad at the shaft; `others`: that moved too, so it is not sure."""

    driver: str
    variants: tuple[str, ...]
    id: int
    way: float
    others: tuple[str, ...]


class _Shaft:
    """One controller's angle, all turns counted."""

    def __init__(self, variants: tuple[str, ...], angle: float, now_ns: int) -> None:
        self.variants = variants
        self.way = 0.0
        self.moved_ns = now_ns
        self._angle = angle
        self._rested = 0.0

    def take(self, sighting: Sighting, angle: float, now_ns: int, move: float) -> None:
        step = angle - self._angle
        if sighting.turn is not None:
            step -= sighting.turn * round(step / sighting.turn)
        self._angle = angle
        self.way += step
        if abs(self.way - self._rested) > move:
            self._rested = self.way
            self.moved_ns = now_ns

    def forget(self) -> None:
        self.way = self._rested = 0.0


class HandWatch:
    """Of the controllers of these kinds; `gear_ratio`: of the wheel that is to be turned."""

    def __init__(self, kinds: Collection[Kind]) -> None:
        self._kinds = frozenset(kinds)
        self._shafts: dict[tuple[str, int, str], _Shaft] = {}
        self._now_ns = 0
        self.gear_ratio = 1.0

    def begin(self, gear_ratio: float) -> None:
        """From here on a wheel with this gear is turned."""
        self.gear_ratio = gear_ratio
        for shaft in self._shafts.values():
            shaft.forget()

    def take(self, frames: Iterable[CanFrame]) -> None:
        """What was received."""
        for frame in frames:
            self._now_ns = max(self._now_ns, frame.received_ns or 0)
            for name, driver in DRIVERS.items():
                for sighting in driver.sighted(frame):
                    if any((name, variant) in self._kinds for variant in sighting.variants):
                        self._see(sighting)

    def _see(self, sighting: Sighting) -> None:
        if sighting.angle is None:
            return
        key = (sighting.driver, sighting.id, sighting.numbering)
        shaft = self._shafts.setdefault(key, _Shaft(sighting.variants, sighting.angle, self._now_ns))
        shaft.take(sighting, sighting.angle, self._now_ns, MOVE * self.gear_ratio)

    def turned(self) -> Turned | None:
        """The turn that is over; None: none yet."""
        ways = sorted(self._shafts.items(), key=lambda item: -abs(item[1].way))
        if not ways or abs(ways[0][1].way) < LEAST * self.gear_ratio:
            return None
        if any(self._now_ns - shaft.moved_ns < REST_NS for _, shaft in ways):
            return None
        (driver, at, _), first = ways[0]
        others = [key for key, shaft in ways[1:] if abs(shaft.way) > OTHERS * abs(first.way)]
        return Turned(driver, first.variants, at, first.way, tuple(f"{name} id {other}" for name, other, _ in others))
