"""What the world may be told of an emergency stop that is not on disk yet: nothing, for a moment.

How this works
--------------
Whoever was told that the robot is stopped relies on it, also after a power cut. So the news of the cycles from the stop
on wait until it is on disk, but no longer than HOLD_NS: with a disk that fails or hangs they are told together with
that fact. The robot itself never waits; it brakes in the cycle of the stop.
"""

from typing import NamedTuple

from gateway.types import Event, Level, Reply, Status

HOLD_NS = 1_000_000_000


class News(NamedTuple):
    """What one cycle tells the world."""

    now_ns: int
    replies: tuple[Reply, ...] = ()
    events: tuple[Event, ...] = ()
    status: Status | None = None


class EstopGate:
    """Lets news through in order; those of a stop once it is on disk, or once `problem` says why it is not."""

    def __init__(self) -> None:
        self._held: list[News] = []
        self._since_ns: int | None = None
        self._told = False

    def step(self, news: News, *, stopped: bool, on_disk: bool, problem: str | None) -> list[News]:
        """What to tell now; called in every cycle."""
        if stopped and not self._told and not on_disk:
            since_ns = self._since_ns = news.now_ns if self._since_ns is None else self._since_ns
            if problem is None and news.now_ns - since_ns < HOLD_NS:
                self._held.append(news)
                return []
            text = problem or f"the emergency stop is not on disk: not written within {HOLD_NS * 1e-9:g} s"
            news = news._replace(events=(*news.events, Event(Level.ERROR, "estop_not_on_disk", text)))
        self._told, self._since_ns = stopped, None
        due, self._held = [*self._held, news], []
        return due
