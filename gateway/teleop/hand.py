"""What a hand on keys or on a gamepad is taken for: the one home of the dead-man, the speed scale and the stop.

How this works
--------------
At every look a device tells a wish, and under which press of its dead-man: each press has a number of its own. A press
counts if it is new at a look at which the robot is ready, and until it ends, a stop is asked for, the robot is no
longer ready, or nobody looked for a while. Then another press is wanted. So nothing that is held at the start, over a
stop or over a refusal ever moves the robot.
"""

from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from gateway.types import ZERO_TWIST, Twist

SCALES = (1.0, 0.75, 0.5, 0.25, 0.1)  # shares of the top
LATE_S = 0.5  # from one look to the next: more, and this computer was asleep or held up


class Wish(NamedTuple):
    """What a device tells at a look.

    `direction`: each part -1 to 1; `press`: number of the press that it is held under, None: nothing is held; `faster`:
    steps of the scale, since the last look.
    """

    direction: Twist = ZERO_TWIST
    press: int | None = None
    stop: bool = False
    reset: bool = False
    quit: bool = False
    faster: int = 0


@dataclass(slots=True)
class Hand:
    """What is to be sent. `top`: m/s and rad/s at full deflection and scale. Time is an argument, s."""

    top: Twist
    counts: bool = False  # what is held moves the robot
    _slower: int = 0  # steps below the top
    _press: int | None = None  # the last that was seen
    _looked: float = -inf

    @property
    def scale(self) -> float:
        """Share of the top."""
        return SCALES[self._slower]

    def order(self, wish: Wish, now: float, *, ready: bool) -> Twist:
        """Of one look; `ready`: the robot drives what we send."""
        self._slower = min(max(self._slower - wish.faster, 0), len(SCALES) - 1)
        fresh = ready and not wish.stop and now - self._looked <= LATE_S
        new = wish.press != self._press
        self.counts = fresh and wish.press is not None and (self.counts or new)
        self._looked, self._press = now, wish.press
        if not self.counts:
            return ZERO_TWIST
        return Twist(*(part * size * self.scale for part, size in zip(wish.direction, self.top, strict=True)))
