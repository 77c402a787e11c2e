"""Whether the robot is at rest: nothing measured turns, and has not turned for a while.

Where too few wheels report to know the motion of the body, those that do may stand while it spins about them: then time
counts as well, and where nothing at all can be measured, instead. No measurement must keep a robot energised for ever,
but braking goes on as long as anything measured turns.
Wheels that stand are no proof: locked on a slippery floor they stand while the body slides on. What it may slide with
falls from its last measured speed as on a floor that gives SLIDING and no more; until then it is held.
"""

from typing import Final

REST_DWELL_NS: Final = 250_000_000  # wheels must stand for so long: creeping is not rest
ROLL_NS: Final = 100_000_000  # a wheel must turn for so long: a touch is no rolling
SLIDING: Final = 1.0  # m/s^2 that every floor gives to wheels that are locked; source: ours, wet tiles or ice give less
STILL: Final = 0.05  # m/s
REST_TIMEOUT_NS: Final = 4_000_000_000  # a robot whose motion is not known is believed to stand after so long


class Standstill:
    """`standing` is None while too few wheels report to know the motion of the body."""

    def __init__(self) -> None:
        self.standing: bool | None = None
        self._slides = 0.0  # m/s at most
        self._slid_ns = 0  # as of then
        self._known_since_ns: int | None = None  # that the body stands
        self._standing_since_ns: int | None = None  # what is measured, if anything is
        self._turning_since_ns: int | None = None
        self._braking_since_ns: int | None = None

    def measure(self, *, turning: bool | None, measurable: bool, now_ns: int) -> None:
        """Take what the wheels say in this cycle. `turning` None: not one of them says anything."""
        self.standing = False if turning else True if measurable else None
        self._known_since_ns = _since(self._known_since_ns, now_ns, holds=self.standing is True)
        self._standing_since_ns = _since(self._standing_since_ns, now_ns, holds=not turning)
        self._turning_since_ns = _since(self._turning_since_ns, now_ns, holds=turning is True)

    def slide(self, speed: float, now_ns: int) -> None:
        """Take how fast the body goes as its wheels have it, m/s; zero where they do not say."""
        left = self._slides - SLIDING * (now_ns - self._slid_ns) * 1e-9
        self._slides, self._slid_ns = (left if left > speed else speed), now_ns

    def command(self, *, braking: bool, now_ns: int) -> None:
        """Take whether the motors are asked for rest in this cycle, or cannot be asked for anything."""
        self._braking_since_ns = _since(self._braking_since_ns, now_ns, holds=braking)

    def rolls(self, now_ns: int) -> bool:
        """Whether a wheel has been turning for a while."""
        return self._turning_since_ns is not None and now_ns - self._turning_since_ns >= ROLL_NS

    def rested(self, now_ns: int) -> bool:
        """Whether the robot may be released."""
        if self._braking_since_ns is None or self._slides > STILL:
            return False
        if self._known_since_ns is not None:
            return now_ns - self._known_since_ns >= REST_DWELL_NS
        if self._standing_since_ns is None:
            return False
        return now_ns - max(self._standing_since_ns, self._braking_since_ns) > REST_TIMEOUT_NS


def _since(before_ns: int | None, now_ns: int, *, holds: bool) -> int | None:
    """When the present stretch of a condition began; None while it does not hold."""
    if not holds:
        return None
    return now_ns if before_ns is None else before_ns
