"""Reads and writes parameters of one ODrive one after the other, each as often as needed until it is answered. Pure.

A write is followed by a read, and only what that tells counts: a confirmation shows what was asked for. Where it tells
something else the write may have been lost, and is tried again. Where nobody answers, nothing more is asked or written.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

from drivers.contract import CanFrame
from drivers.odrive.endpoints import Endpoint, Value, answered, read_request, write_request

PATIENCE_S: Final = 0.15  # until a question is asked again
ATTEMPTS: Final = 5
WRITES: Final = 3
SETTLE_S: Final = 0.05  # after a write, in which a confirmation would come


class Job(NamedTuple):
    """A parameter to read, and before that to write, where there is a value."""

    endpoint: Endpoint
    value: Value | None = None


class Exchange:
    """`questions` and `take` are called in turns; s since the begin come in as an argument."""

    def __init__(self, node: int, jobs: Sequence[Job]) -> None:
        self._node = node
        self._jobs = list(jobs)
        self.values: dict[str, Value] = {}  # by path, as they were read
        self.silent: Endpoint | None = None  # nobody answered of it
        self._writes = 0  # of the first job
        self._to_write = True
        self._asked = 0
        self._next_s = 0.0

    @property
    def finished(self) -> bool:
        return not self._jobs or self.silent is not None

    def questions(self, gone_s: float) -> list[CanFrame]:
        """What to send now."""
        if self.finished or gone_s < self._next_s:
            return []
        endpoint, value = self._jobs[0]
        if self._to_write and value is not None:
            self._to_write = False
            self._writes += 1
            self._next_s = gone_s + SETTLE_S
            return [write_request(self._node, endpoint, endpoint.raw(value))]
        if self._asked >= ATTEMPTS:
            self.silent = endpoint
            return []
        self._asked += 1
        self._next_s = gone_s + PATIENCE_S
        return [read_request(self._node, endpoint)]

    def take(self, frame: CanFrame) -> None:
        """What was received."""
        if self.finished or self._asked == 0:
            return
        endpoint, wanted = self._jobs[0]
        raw = answered(self._node, endpoint, frame)
        value = None if raw is None else endpoint.value(raw)
        if raw is None or value is None:
            return
        self.values[endpoint.path] = value
        if wanted is None or raw.startswith(endpoint.raw(wanted)) or self._writes >= WRITES:
            del self._jobs[0]
            self._writes = 0
        self._to_write = True
        self._asked = 0
        self._next_s = 0.0
