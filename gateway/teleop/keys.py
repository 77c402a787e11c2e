"""What the keys of a terminal ask for.

A terminal reports presses and repeats, no releases: a key counts as held until its repeats stop for RELEASE_S.
"""

from dataclasses import dataclass

from gateway.teleop.hand import Wish
from gateway.types import ZERO_TWIST, Twist

RELEASE_S = 0.6  # terminals wait up to half a second before the first repeat
KEYS = {
    "w": Twist(1.0, 0.0, 0.0),
    "s": Twist(-1.0, 0.0, 0.0),
    "a": Twist(0.0, 1.0, 0.0),
    "d": Twist(0.0, -1.0, 0.0),
    "q": Twist(0.0, 0.0, 1.0),
    "e": Twist(0.0, 0.0, -1.0),
    " ": ZERO_TWIST,
}
FASTER_KEYS, SLOWER_KEY = ("+", "="), "-"  # "=" is "+" without the shift key on many keyboards
QUIT_KEYS = frozenset({"x", "\x03", "\x04"})
STOP_KEY, RESET_KEY = "!", "r"
MOVING_HELP = "w/s forward/back  a/d left/right  q/e turn  space zero  +/- speed"
HELP = "! emergency stop  r reset  x quit"


@dataclass(slots=True)
class Keys:
    """A keyboard. Time is an argument, s."""

    _held: Twist = ZERO_TWIST
    _held_since: float = 0.0
    _presses: int = 0

    def press(self, keys: str, now: float) -> Wish:
        """All keys of one read: of those that move the last one counts, and a stop wins over all that move or reset."""
        stop = STOP_KEY in keys
        for key in keys:
            if key in KEYS:
                self._hold(KEYS[key], now)
        if stop or now - self._held_since > RELEASE_S:
            self._held = ZERO_TWIST
        return Wish(
            direction=self._held,
            press=None if self._held == ZERO_TWIST else self._presses,
            stop=stop,
            reset=RESET_KEY in keys and not stop,
            quit=not QUIT_KEYS.isdisjoint(keys),
            faster=len([key for key in keys if key in FASTER_KEYS]) - keys.count(SLOWER_KEY),
        )

    def _hold(self, direction: Twist, now: float) -> None:
        """The first key after none is a press; another one in its place is not."""
        if self._held == ZERO_TWIST and direction != ZERO_TWIST:
            self._presses += 1
        self._held, self._held_since = direction, now
