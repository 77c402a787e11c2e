"""One ODrive saves its settings and restarts: told once, then watched until it has been away and is back. Pure.

Reading before it has been away would only tell what is in its memory, saved or not. Time is that of the heartbeats'
stamps, so that a computer that stalls takes no stall for a restart.
"""

from typing import Final

from drivers.contract import CanFrame
from drivers.odrive import tables
from drivers.odrive.endpoints import save_request

AWAY_NS: Final = 250_000_000  # without a heartbeat, of which the slowest that is allowed come every 0.1 s
BACK_NS: Final = 300_000_000  # of heartbeats
FIRST_S: Final = 0.5
PATIENCE_S: Final = 10.0


class Restart:
    """`questions` and `take` are called in turns; s since the begin come in as an argument."""

    def __init__(self, node: int) -> None:
        self._node = node
        self.told = False
        self._last_ns: int | None = None
        self._back_ns: int | None = None  # since when, after it was away

    @property
    def finished(self) -> bool:
        """Whether it has been away and is back for long enough to be asked."""
        return self._back_ns is not None and (self._last_ns or 0) - self._back_ns >= BACK_NS

    def questions(self, gone_s: float) -> list[CanFrame]:
        """What to send now: once, after a heartbeat, from which its absence counts, or where none comes."""
        if self.told or (self._last_ns is None and gone_s < FIRST_S):
            return []
        self.told = True
        return [save_request(self._node)]

    def take(self, frame: CanFrame) -> None:
        """What was received."""
        if frame.id != self._node << tables.NODE_SHIFT | tables.HEARTBEAT or frame.extended or frame.remote:
            return
        now_ns = frame.received_ns or 0
        if self.told and self._back_ns is None and self._last_ns is not None and now_ns - self._last_ns >= AWAY_NS:
            self._back_ns = now_ns
        self._last_ns = now_ns
