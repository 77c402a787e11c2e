"""A speed over time that a motor is to follow, and the way that makes: straight lines between knots. Pure."""

from collections.abc import Sequence
from itertools import pairwise

Knot = tuple[float, float]  # s, rad/s; two at one time are a step


class Course:
    """From rest to rest, never backwards."""

    def __init__(self, knots: Sequence[Knot]) -> None:
        self._pieces = tuple(pairwise(knots))
        self.seconds = knots[-1][0]
        self.top = max(speed for _, speed in knots)

    def at(self, gone: float) -> tuple[float, float]:
        """Speed, rad/s, and way, rad, after so many seconds."""
        speed = way = 0.0
        for (begin, first), (end, last) in self._pieces:
            if gone < begin:
                break
            time, length = min(gone, end) - begin, end - begin
            speed = first + (last - first) * time / length if length > 0.0 else last
            way += 0.5 * (first + speed) * time
        return (speed if gone < self.seconds else 0.0), way


def trapezoid(top: float, seconds: float, *, ramp: float) -> Course:
    """Rises, stays and falls; `ramp`: of the time, that each slope takes."""
    rise = ramp * seconds
    return Course([(0.0, 0.0), (rise, top), (seconds - rise, top), (seconds, 0.0)])


def stairs(top: float, seconds: float, *, low: float, ramp: float, step: float) -> Course:
    """Rises, steps between `low` and all of the speed every `step` s, and falls; `ramp`, `low`: shares."""
    rise = ramp * seconds
    knots = [(0.0, 0.0), (rise, low * top)]
    at, up = rise + step, True
    while at < seconds - rise:
        knots += [(at, knots[-1][1]), (at, top if up else low * top)]
        at, up = at + step, not up
    return Course([*knots, (seconds - rise, knots[-1][1]), (seconds, 0.0)])
