"""Whether the core does the same again in the cycles of an incident: a short form of `drivegate replay verify`."""

from collections.abc import Iterable

import msgspec

from gateway.config import RobotConfig
from gateway.core.engine import Engine
from gateway.core.snapshot import SnapshotError
from gateway.recording.incident import Judgement
from gateway.recording.packets import Packet, Record, Snapshot

COMPARED = ("frames", "mode", "events", "replies", "odometry")  # of Outputs, as in replay.sessions.cycles
# What a core may raise that is given a state or inputs which it never had.
CRASHES = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError)
IDENTICAL, DIFFERENT, INCOMPLETE, NOT_REPLAYABLE = "identical", "different", "incomplete", "not replayable"


class _Judge:
    """The core beside the recorded cycles, from the first state of it that is known."""

    def __init__(self, config: RobotConfig) -> None:
        self.cycles = self.unseen = 0
        self.difference: str | None = None
        self.missing = False  # a cycle is, behind the state with which it begins
        self._config = config
        self._engine: Engine | None = None
        self._snapshot: Snapshot | None = None
        self._next = 0

    def hear(self, packet: Packet) -> None:
        if isinstance(packet, Snapshot):
            self._snapshot = packet
            self._next = self._next or packet.cycle + 1
        elif isinstance(packet, Record):
            self._step(packet)

    def _step(self, record: Record) -> None:
        cycle = record.inputs.cycle
        self.missing = self.missing or self._next != cycle
        if self._engine is None or self._next != cycle:
            self._engine = self._restored(cycle)
        self._next = cycle + 1
        if self._engine is None:
            self.unseen += 1
            return
        self.cycles += 1
        different = _different(self._engine, record)
        self.difference = None if different is None else f"cycle {cycle}: {different}"

    def _restored(self, cycle: int) -> Engine | None:
        if cycle == 0:
            return Engine(self._config)
        if self._snapshot is None or self._snapshot.cycle != cycle - 1:
            return None
        try:
            return Engine(self._config, msgspec.msgpack.decode(self._snapshot.state, type=dict))
        except SnapshotError:
            return None


def judgement(config: RobotConfig, packets: Iterable[Packet]) -> Judgement:
    """Of all that lies between the first and the last cycle; of what differs the first is told."""
    judge = _Judge(config)
    for packet in packets:
        judge.hear(packet)
        if judge.difference is not None:
            break
    verdict = IDENTICAL
    if judge.difference is not None:
        verdict = DIFFERENT
    elif not judge.cycles:
        verdict = NOT_REPLAYABLE
    elif judge.missing or judge.unseen:
        verdict = INCOMPLETE
    return Judgement(verdict, judge.cycles, judge.unseen, judge.difference)


def _different(engine: Engine, record: Record) -> str | None:
    """What of a cycle the core says otherwise now."""
    try:
        outputs = engine.step(record.inputs)
    except CRASHES as error:
        return f"exception {error!r}"
    return next((name for name in COMPARED if getattr(outputs, name) != getattr(record.outputs, name)), None)
