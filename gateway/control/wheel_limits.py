"""What the wheels of a chassis whose geometry no joint angle changes can do: top speeds, and how fast they may change.

How this works
--------------
Wheel speeds are linear in the rates of the body, so each limit of a wheel is a strip in the space of those rates, and
all of them together a convex body: how much of a change it holds is the least over the wheels.
"""

from collections.abc import Sequence
from typing import Final

from gateway.arithmetic import dot
from gateway.kinematics.linear import Matrix
from gateway.types import Rates

_LONG: Final = 1e9  # s: what a wheel that may not change takes


class WheelLimits:
    """`rows`: rad/s per unit of each axis; `speeds`: rad/s; `accelerations`: rad/s^2, empty for none. Keeps nothing."""

    def __init__(self, rows: Matrix, *, speeds: Sequence[float], accelerations: Sequence[float] = ()) -> None:
        self._rows = rows
        self.speeds = tuple(speeds)
        self.accelerations = tuple(accelerations)

    def use(self, rates: Rates) -> list[float]:
        """What each wheel does for rates of the body, without its sign."""
        return [abs(dot(row, rates)) for row in self._rows]

    def left(self, rates: Rates) -> list[float]:
        """What this acceleration of the body leaves of the acceleration of each wheel, whichever way it turns."""
        return [max(0.0, limit - used) for limit, used in zip(self.accelerations, self.use(rates))]

    def seconds(self, way: Rates, accelerations: Sequence[float]) -> float:
        """How long the slowest wheel takes to change its speed for this change of the body's, s."""
        longest = 0.0
        for used, limit in zip(self.use(way), accelerations):
            if used > 0.0:
                longest = max(longest, used / limit if used < limit * _LONG else _LONG)
        return longest

    def share(self, kept: Rates, added: Rates, limits: Sequence[float]) -> float:
        """Largest share, 0 to 1, of rates that can be added to others; 0 where these alone are beyond a limit."""
        share = 1.0
        for row, limit in zip(self._rows, limits):
            more = dot(row, added)
            if more != 0.0:
                there = dot(row, kept)
                share = min(share, (limit - (there if more > 0.0 else -there)) / abs(more))
        return max(0.0, share)
