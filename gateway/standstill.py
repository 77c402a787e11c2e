"""Whether the robot is at rest: its setpoint is zero, and its wheels have stood for a while.

Wheels that cannot be measured get their time instead: no measurement must not keep a robot energised for ever.
"""

REST_DWELL_NS = 250_000_000  # wheels must stand for so long: creeping is not rest
REST_TIMEOUT_NS = 4_000_000_000  # a robot that cannot be measured is believed to stand this long after setpoint zero


class Standstill:
    """`standing` is None while too few wheels report to know."""

    def __init__(self) -> None:
        self.standing: bool | None = None
        self._standing_since_ns: int | None = None
        self._zero_since_ns: int | None = None

    def measure(self, *, turning: bool, measurable: bool, now_ns: int) -> None:
        """Take what the wheels say in this cycle."""
        self.standing = False if turning else True if measurable else None
        if not self.standing:
            self._standing_since_ns = None
        elif self._standing_since_ns is None:
            self._standing_since_ns = now_ns

    def command(self, *, zero: bool, now_ns: int) -> None:
        """Take whether the setpoint of this cycle is zero."""
        if not zero:
            self._zero_since_ns = None
        elif self._zero_since_ns is None:
            self._zero_since_ns = now_ns

    def rested(self, now_ns: int) -> bool:
        """Whether the robot may be released."""
        if self._zero_since_ns is None:
            return False
        stood = self._standing_since_ns is not None and now_ns - self._standing_since_ns >= REST_DWELL_NS
        return stood or now_ns - self._zero_since_ns > REST_TIMEOUT_NS
