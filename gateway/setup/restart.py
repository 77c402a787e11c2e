"""One ODrive saves its settings and restarts: told once, then watched until it has been away and is back. Pure.

Reading before it has been away would only tell what is in its memory, saved or not.
"""

from typing import Final

from drivers.contract import CanFrame
from drivers.odrive import tables
from drivers.odrive.endpoints import save_request

AWAY_S: Final = 0.25  # without a heartbeat, of which the slowest that is allowed come every 0.1 s
BACK_S: Final = 0.3  # of heartbeats
PATIENCE_S: Final = 10.0


class Restart:
    """`questions` and `take` are called in turns; s since the begin come in as an argument."""

    def __init__(self, node: int) -> None:
        self._node = node
        self._told = False
        self._now_s = self._last_s = 0.0
        self._back_s: float | None = None  # since when, after it was away

    @property
    def finished(self) -> bool:
        """Whether it has been away and is back for long enough to be asked."""
        return self._back_s is not None and self._last_s - self._back_s >= BACK_S

    def questions(self, gone_s: float) -> list[CanFrame]:
        """What to send now."""
        self._now_s = gone_s
        if self._told:
            return []
        self._told = True
        return [save_request(self._node)]

    def take(self, frame: CanFrame) -> None:
        """What was received."""
        if frame.id != self._node << tables.NODE_SHIFT | tables.HEARTBEAT or frame.extended or frame.remote:
            return
        if self._back_s is None and self._now_s - self._last_s >= AWAY_S:
            self._back_s = self._now_s
        self._last_s = self._now_s
