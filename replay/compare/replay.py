"""Which core a recorded cycle is run through: from cycle 0 on, and behind a gap from the next snapshot on."""

from collections.abc import Callable
from typing import Any

from gateway.config import RobotConfig
from gateway.core.engine import Engine
from gateway.core.snapshot import SnapshotError
from gateway.types import Inputs, Outputs
from replay.sessions.cycles import COMPARED, RecordedOutputs

# What a core may raise that is given inputs which it never had: damaged ones, or those of another version.
CRASHES = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError)


class Replay:
    """Give it the inputs of every cycle of a session, in order. Raises ConfigError at construction.

    `snapshot`: the recorded state of the core after a cycle, if there is one. `unseen`: cycles for which there was no
    core. `covered_ns`: the time that the others cover. `refused`: why a snapshot could not be used.
    """

    def __init__(self, config: RobotConfig, snapshot: Callable[[int], dict[str, Any] | None]) -> None:
        self.unseen = 0
        self.covered_ns = 0
        self.refused: str | None = None
        self._config = config
        self._snapshot = snapshot
        self._engine: Engine | None = Engine(config)
        self._next = 0
        self._last_ns: int | None = None

    def engine(self, inputs: Inputs) -> Engine | None:
        """The core in the state of before this cycle; None if nobody knows that state."""
        cycle, now_ns = inputs[:2]
        if cycle != self._next or self._engine is None:
            self._engine = self._restored(cycle - 1)
            self._last_ns = None
        self._next = cycle + 1
        if self._engine is None:
            self.unseen += 1
            return None
        if self._last_ns is not None:
            self.covered_ns += now_ns - self._last_ns
        self._last_ns = now_ns
        return self._engine

    @property
    def last_ns(self) -> int | None:
        """The time of the cycle before; None if it had no core."""
        return self._last_ns

    def state(self) -> dict[str, Any] | None:
        """Of the core after the cycle before; None if nobody knows it."""
        return None if self._engine is None else self._engine.snapshot()

    def lose(self) -> None:
        """The core has broken: there is none until the next snapshot."""
        self._engine = None

    def restore(self, cycle: int) -> bool:
        """Give the core the state recorded after this cycle, the last one; whether there is such a state."""
        engine = self._restored(cycle)
        self._engine = engine or self._engine
        return engine is not None

    def _restored(self, cycle: int) -> Engine | None:
        state = self._snapshot(cycle)
        if state is None:
            return None
        try:
            return Engine(self._config, state)
        except SnapshotError as error:
            self.refused = self.refused or f"after cycle {cycle}: {error}"
            return None


def same(outputs: Outputs, recorded: RecordedOutputs) -> bool:
    """Whether the core says again what it said: what is recorded comes first in what it says."""
    return outputs[:COMPARED] == recorded
