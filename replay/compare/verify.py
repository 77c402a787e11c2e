"""The verdict: the recorded inputs of a session, run through the same core, must give the recorded outputs.

Compared are, cycle by cycle: every CAN frame, the mode, replies, events and odometry. The first difference is
reported in words: cycle, motor, field and both values, decoded by the driver the frame belongs to.

How this works
--------------
The core is run from cycle 0 to the first cycle that is missing; beyond that its state is not known until the next
snapshot of it, every five seconds in the recording, from where it is run on. So a single segment is compared as well,
and what is left of a session whose beginning was deleted; recorded cycles that could not be compared are counted in
`unseen`. Only a session all of which is provably there (see `replay.sessions.reader`) can be called identical.

| what was compared | the recording is complete | it is not |
|---|---|---|
| something differs | 1 | 1 |
| at least one cycle, all equal | 0 | 3 |
| nothing, because the recorder deleted the beginning to make room | - | 3 |
| nothing else | 2 | 2 |
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import NamedTuple

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.core.engine import Engine
from gateway.core.frame_words import FrameWords, fields, raw
from gateway.types import Inputs, Outputs
from replay.compare.replay import CRASHES, Replay, same
from replay.compare.side_by_side import Compared, confirmed
from replay.sessions.reader import RecordedOutputs, Session
from replay.sessions.software import change

PROGRESS_CYCLES = 1000
NOTHING_TO_COMPARE = "a log of frames tells no commands, so nobody knows what the core would have had to say"
EXIT_IDENTICAL, EXIT_DIFFERENT, EXIT_NOT_REPLAYABLE, EXIT_INCOMPLETE = range(4)


class Difference(NamedTuple):
    """Where the replay first left the recording."""

    cycle: int
    motor: str | None
    field: str
    recorded: str
    replayed: str


class Verdict(NamedTuple):
    """What verify found.

    `identical`: every cycle was recorded, is there, and was equal. `complete`: nothing is missing or damaged;
    otherwise, or if nothing could be compared, `problem` says what. `cycles` and `frames` are those compared, `unseen`
    those that are there and could not be: behind a gap, with no snapshot since; `refused`: why one was of no use.
    `software_change`: only where something differs, what of the software is not what it was. `first_unproven`: the
    first cycle that is missing or not provably as it was recorded. `seconds`: what the cycles compared cover.
    """

    identical: bool
    complete: bool
    cycles: int
    frames: int
    unseen: int
    realtime_ratio: float
    first_difference: Difference | None
    problem: str | None
    refused: str | None
    exit_code: int
    software_change: str | None = None
    first_unproven: int | None = None
    seconds: float = 0.0

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        difference = self.first_difference
        told = self._asdict() | {
            "realtime_ratio": round(self.realtime_ratio, 2),
            "first_difference": None if difference is None else difference._asdict(),
        }
        del told["seconds"]
        return told


def not_replayable(problem: str) -> Verdict:
    """The verdict on what cannot be opened, or whose robot file this version refuses."""
    return Verdict(
        identical=False,
        complete=False,
        cycles=0,
        frames=0,
        unseen=0,
        realtime_ratio=0.0,
        first_difference=None,
        problem=problem,
        refused=None,
        exit_code=EXIT_NOT_REPLAYABLE,
    )


def verify(session: Session, progress: Callable[[int], None] | None = None, *, pool: Executor | None = None) -> Verdict:
    """Re-run every recorded cycle, here or side by side. `progress` is told how many more cycles are done.

    The verdict is the same with a pool (`replay.compare.side_by_side`) and without, but for the time that it took.
    Raises ConfigError if this version of the software refuses the recorded robot file.
    """
    if session.header.imported is not None:
        return not_replayable(f"imported from {session.header.imported}: {NOTHING_TO_COMPARE}")
    config = parse(session.config_text, "robot file of the session")
    told = _Progress(progress)
    started_ns = time.perf_counter_ns()
    found = None if pool is None else confirmed(session, pool, told.add)
    if found is not None:
        return _verdict(found.session, found.compared, None, started_ns)
    replay, words = Replay(config, session.snapshot), FrameWords(config)
    cycles = frames = 0
    difference = None
    for done, (inputs, recorded) in enumerate(session.cycles(), start=1):
        engine = replay.engine(inputs)
        if engine is not None:
            difference = _step(engine, words, inputs, recorded)
            cycles += 1
            frames += len(recorded.frames)
        if difference is not None:
            break
        if done % PROGRESS_CYCLES == 0:
            told.reach(done)
    compared = Compared(cycles, frames, replay.unseen, replay.covered_ns)
    return _verdict(session, compared, difference, started_ns, replay.refused)


class _Progress:
    """Tells of each cycle once, also of those that are run a second time."""

    def __init__(self, tell: Callable[[int], None] | None) -> None:
        self._tell = tell
        self._told = 0

    def add(self, cycles: int) -> None:
        self._told += cycles
        if self._tell is not None:
            self._tell(cycles)

    def reach(self, cycles: int) -> None:
        if cycles > self._told:
            self.add(cycles - self._told)


def _verdict(
    session: Session, compared: Compared, difference: Difference | None, started_ns: int, refused: str | None = None
) -> Verdict:
    elapsed_ns = max(time.perf_counter_ns() - started_ns, 1)
    problem = session.problem or (None if compared.cycles else "the session holds no cycles")
    exit_code = _exit_code(difference, compared.cycles, complete=problem is None, pruned=session.pruned)
    return Verdict(
        identical=exit_code == EXIT_IDENTICAL,
        complete=problem is None,
        cycles=compared.cycles,
        frames=compared.frames,
        unseen=compared.unseen,
        realtime_ratio=compared.covered_ns / elapsed_ns,
        first_difference=difference,
        problem=problem,
        refused=refused,
        exit_code=exit_code,
        software_change=None if difference is None else change(session.header),
        first_unproven=session.first_unproven,
        seconds=compared.covered_ns * 1e-9,
    )


def _exit_code(difference: Difference | None, cycles: int, *, complete: bool, pruned: bool) -> int:
    if difference is not None:
        return EXIT_DIFFERENT
    if cycles and complete:
        return EXIT_IDENTICAL
    return EXIT_INCOMPLETE if cycles or pruned else EXIT_NOT_REPLAYABLE


def _step(engine: Engine, words: FrameWords, inputs: Inputs, recorded: RecordedOutputs) -> Difference | None:
    """One cycle; a core that breaks on what it once answered, as it may on damaged inputs, answers differently."""
    try:
        outputs = engine.step(inputs)
    except CRASHES as error:
        return Difference(inputs.cycle, None, "answer", f"{len(recorded.frames)} frames", f"exception {error!r}")
    return None if same(outputs, recorded) else _difference(inputs.cycle, words, outputs, recorded)


def _difference(cycle: int, words: FrameWords, outputs: Outputs, recorded: RecordedOutputs) -> Difference:
    """The first thing that differs, frames before words: they are what moves the robot."""
    if outputs.frames != recorded.frames:
        return _frame_difference(cycle, words, recorded.frames, outputs.frames)
    for field in ("mode", "odometry", "events", "replies"):
        before, after = getattr(recorded, field), getattr(outputs, field)
        if before != after:
            return Difference(cycle, None, field, str(before), str(after))
    message = "no field differs"
    raise AssertionError(message)


def _frame_difference(
    cycle: int, words: FrameWords, recorded: Sequence[CanFrame], replayed: Sequence[CanFrame]
) -> Difference:
    for before, after in zip(recorded, replayed, strict=False):
        if before != after:
            return _field_difference(cycle, words, before, after)
    if len(recorded) > len(replayed):
        frame = recorded[len(replayed)]
        return Difference(cycle, _words(words, frame)[0], "frame", _words(words, frame)[1], "no such frame")
    frame = replayed[len(recorded)]
    return Difference(cycle, _words(words, frame)[0], "frame", "no such frame", _words(words, frame)[1])


def _field_difference(cycle: int, words: FrameWords, before: CanFrame, after: CanFrame) -> Difference:
    one, other = words.decode(before), words.decode(after)
    if one is not None and other is not None and one[:2] == other[:2]:
        owners = one.owners or (one.motor,) * len(one.fields)
        for motor, (field, value), (_, changed) in zip(owners, one.fields, other.fields, strict=True):
            if value != changed:
                return Difference(cycle, motor, f"{one.message}.{field}", str(value), str(changed))
    return Difference(cycle, _words(words, before)[0], "frame", _words(words, before)[1], _words(words, after)[1])


def _words(words: FrameWords, frame: CanFrame) -> tuple[str | None, str]:
    decoded = words.decode(frame)
    if decoded is None:
        return None, raw(frame)
    return decoded.motor, f"{fields(decoded)} ({raw(frame)})"
