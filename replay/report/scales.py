"""From values to places in a figure, round ticks, and paths of SVG in few bytes.

Curves are drawn in a box of `WIDE` by `HIGH` that the page stretches to its width; words stand beside them as text of
the page, so that they are as large on a telephone as on a screen. Places of words are in percent.
"""

from collections.abc import Iterable
from math import ceil, floor, isfinite, log10
from typing import NamedTuple

WIDE, HIGH = 4000, 1000


class Tick(NamedTuple):
    """Words at a place, percent."""

    at: float
    words: str


class Scale(NamedTuple):
    """From a value to a place in the picture."""

    low: float
    high: float
    start: float
    end: float

    def at(self, value: float) -> float:
        return self.start + self.part(value) * (self.end - self.start)

    def part(self, value: float) -> float:
        """0 at the low end, 1 at the high one."""
        return (value - self.low) / (self.high - self.low)


def across(seconds: float) -> Scale:
    """Time, s."""
    return Scale(0.0, max(seconds, 1e-3), 0.0, WIDE)


def upwards(low: float, high: float) -> Scale:
    """Values, with some room."""
    return Scale(*padded(low, high), HIGH, 0.0)


def padded(low: float, high: float) -> tuple[float, float]:
    """With some room, also where nothing changes."""
    room = 0.06 * (high - low) if high - low > 1e-9 else max(0.05, 0.05 * abs(low))
    return low - room, high + room


def rounds(scale: Scale, most: int) -> list[float]:
    """Round values, so many at most: 1, 2 or 5 times a power of ten apart."""
    rough = (scale.high - scale.low) / most
    power = 10.0 ** floor(log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    return [number * step for number in range(ceil(scale.low / step), floor(scale.high / step) + 1)]


def figure(value: float) -> str:
    """A tick's number, without the dust of its arithmetic."""
    return f"{value:.6g}"


def ticks(scale: Scale, most: int, unit: str = "") -> list[Tick]:
    """Along the picture, from left or from the top; the unit stands with the first one."""
    found = [(value, 100.0 * (scale.at(value) / max(scale.start, scale.end))) for value in rounds(scale, most)]
    units = [unit] + [""] * len(found)
    return [Tick(round(at, 2), figure(value) + units[place]) for place, (value, at) in enumerate(found)]


def path(points: Iterable[tuple[float, float]]) -> str:
    """A line through these, in whole units and from each to the next; what is not finite parts it."""
    found: list[str] = []
    pen: tuple[int, int] | None = None
    for a, b in points:
        if not (isfinite(a) and isfinite(b)):
            pen = None
            continue
        x, y = round(a), round(b)
        if pen is None:
            found.append(f"M{x} {y}l0 0")
        elif (x, y) != pen:
            found.append(f"{x - pen[0]:+d}{y - pen[1]:+d}")
        pen = x, y
    return "".join(found).replace("+", " ")
