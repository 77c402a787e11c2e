"""Which core a recorded cycle is run through: from cycle 0 on, and behind a gap from the next snapshot on."""

from gateway.config import RobotConfig
from gateway.core.engine import Engine
from gateway.core.snapshot import SnapshotError
from gateway.types import Inputs
from replay.sessions.reader import Session


class Replay:
    """Give it the inputs of every cycle of a session, in order. Raises ConfigError at construction.

    `unseen`: cycles for which there was no core. `covered_ns`: the time that the others cover. `refused`: why a
    snapshot could not be used.
    """

    def __init__(self, config: RobotConfig, session: Session) -> None:
        self.unseen = 0
        self.covered_ns = 0
        self.refused: str | None = None
        self._config = config
        self._session = session
        self._engine: Engine | None = Engine(config)
        self._next = 0
        self._last_ns: int | None = None

    def engine(self, inputs: Inputs) -> Engine | None:
        """The core in the state of before this cycle; None if nobody knows that state."""
        if inputs.cycle != self._next or self._engine is None:
            self._engine = self._restored(inputs.cycle - 1)
            self._last_ns = None
        self._next = inputs.cycle + 1
        if self._engine is None:
            self.unseen += 1
            return None
        self.covered_ns += 0 if self._last_ns is None else inputs.now_ns - self._last_ns
        self._last_ns = inputs.now_ns
        return self._engine

    def _restored(self, cycle: int) -> Engine | None:
        state = self._session.snapshot(cycle)
        if state is None:
            return None
        try:
            return Engine(self._config, state)
        except SnapshotError as error:
            self.refused = self.refused or f"after cycle {cycle}: {error}"
            return None
