"""The verdict: the recorded inputs of a session, run through the same core, must give the recorded outputs.

Compared are, cycle by cycle: every CAN frame, the mode, replies, events and odometry. The first difference is
reported in words: cycle, motor, field and both values, decoded by the driver the frame belongs to.

How this works
--------------
The core is run from cycle 0 to the first cycle that is missing; beyond that its state is not known. Only a session
all of which is provably there (see `replay.sessions.reader`) can be called identical.

| what was compared | the recording is complete | it is not |
|---|---|---|
| something differs | 1 | 1 |
| at least one cycle, all equal | 0 | 3 |
| nothing, because the recorder deleted the beginning to make room | - | 3 |
| nothing else | 2 | 2 |
"""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from drivers.contract import CanFrame, DecodedFrame
from gateway.config import parse
from gateway.core.assembly import Robot, build
from gateway.core.engine import Engine
from gateway.types import Inputs, Outputs
from replay.sessions.reader import RecordedOutputs, Session
from replay.sessions.software import change

PROGRESS_CYCLES = 1000
EXIT_IDENTICAL, EXIT_DIFFERENT, EXIT_NOT_REPLAYABLE, EXIT_INCOMPLETE = range(4)
_CRASHES = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError)


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
    otherwise, or if nothing could be compared, `problem` says what. `cycles` and `frames` are those compared.
    `software_change`: only where something differs, what of the software is not what it was.
    """

    identical: bool
    complete: bool
    cycles: int
    frames: int
    realtime_ratio: float
    first_difference: Difference | None
    problem: str | None
    exit_code: int
    software_change: str | None = None

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        difference = self.first_difference
        return self._asdict() | {
            "realtime_ratio": round(self.realtime_ratio, 2),
            "first_difference": None if difference is None else difference._asdict(),
        }


def not_replayable(problem: str) -> Verdict:
    """The verdict on what cannot be opened, or whose robot file this version refuses."""
    return Verdict(
        identical=False,
        complete=False,
        cycles=0,
        frames=0,
        realtime_ratio=0.0,
        first_difference=None,
        problem=problem,
        exit_code=EXIT_NOT_REPLAYABLE,
    )


def verify(session: Session, progress: Callable[[int], None] | None = None) -> Verdict:
    """Re-run every recorded cycle. `progress` is called with the number of cycles done since its last call.

    Raises ConfigError if this version of the software refuses the recorded robot file.
    """
    config = parse(session.config_text, "robot file of the session")
    engine, robot = Engine(config), build(config)
    started_ns = time.perf_counter_ns()
    cycles = frames = 0
    first_ns = last_ns = None
    difference = None
    for inputs, recorded in session.cycles():
        if inputs.cycle != cycles:
            break
        difference = _step(engine, robot, inputs, recorded)
        cycles += 1
        frames += len(recorded.frames)
        first_ns, last_ns = first_ns or inputs.now_ns, inputs.now_ns
        if difference is not None:
            break
        if progress is not None and cycles % PROGRESS_CYCLES == 0:
            progress(PROGRESS_CYCLES)
    elapsed_ns = max(time.perf_counter_ns() - started_ns, 1)
    covered_ns = (last_ns or 0) - (first_ns or 0)
    problem = session.problem or (None if cycles else "the session holds no cycles")
    exit_code = _exit_code(difference, cycles, complete=problem is None, pruned=session.pruned)
    return Verdict(
        identical=exit_code == EXIT_IDENTICAL,
        complete=problem is None,
        cycles=cycles,
        frames=frames,
        realtime_ratio=covered_ns / elapsed_ns,
        first_difference=difference,
        problem=problem,
        exit_code=exit_code,
        software_change=None if difference is None else change(session.header),
    )


def _exit_code(difference: Difference | None, cycles: int, *, complete: bool, pruned: bool) -> int:
    if difference is not None:
        return EXIT_DIFFERENT
    if cycles and complete:
        return EXIT_IDENTICAL
    return EXIT_INCOMPLETE if cycles or pruned else EXIT_NOT_REPLAYABLE


def _step(engine: Engine, robot: Robot, inputs: Inputs, recorded: RecordedOutputs) -> Difference | None:
    """One cycle; a core that breaks on what it once answered, as it may on damaged inputs, answers differently."""
    try:
        outputs = engine.step(inputs)
    except _CRASHES as error:
        return Difference(inputs.cycle, None, "answer", f"{len(recorded.frames)} frames", f"exception {error!r}")
    return None if _same(outputs, recorded) else _difference(inputs.cycle, robot, outputs, recorded)


def _same(outputs: Outputs, recorded: RecordedOutputs) -> bool:
    return (
        outputs.frames == recorded.frames
        and outputs.mode is recorded.mode
        and outputs.odometry == recorded.odometry
        and outputs.events == recorded.events
        and outputs.replies == recorded.replies
    )


def _difference(cycle: int, robot: Robot, outputs: Outputs, recorded: RecordedOutputs) -> Difference:
    """The first thing that differs, frames before words: they are what moves the robot."""
    if outputs.frames != recorded.frames:
        return _frame_difference(cycle, robot, recorded.frames, outputs.frames)
    for field in ("mode", "odometry", "events", "replies"):
        before, after = getattr(recorded, field), getattr(outputs, field)
        if before != after:
            return Difference(cycle, None, field, str(before), str(after))
    message = "no field differs"
    raise AssertionError(message)


def _frame_difference(
    cycle: int, robot: Robot, recorded: Sequence[CanFrame], replayed: Sequence[CanFrame]
) -> Difference:
    for before, after in zip(recorded, replayed, strict=False):
        if before != after:
            return _field_difference(cycle, robot, before, after)
    if len(recorded) > len(replayed):
        frame = recorded[len(replayed)]
        return Difference(cycle, _words(robot, frame)[0], "frame", _words(robot, frame)[1], "no such frame")
    frame = replayed[len(recorded)]
    return Difference(cycle, _words(robot, frame)[0], "frame", "no such frame", _words(robot, frame)[1])


def _field_difference(cycle: int, robot: Robot, before: CanFrame, after: CanFrame) -> Difference:
    one, other = _decode(robot, before), _decode(robot, after)
    if one is not None and other is not None and one[:2] == other[:2]:
        owners = one.owners or (one.motor,) * len(one.fields)
        for motor, (field, value), (_, changed) in zip(owners, one.fields, other.fields, strict=True):
            if value != changed:
                return Difference(cycle, motor, f"{one.message}.{field}", str(value), str(changed))
    return Difference(cycle, _words(robot, before)[0], "frame", _words(robot, before)[1], _words(robot, after)[1])


def _decode(robot: Robot, frame: CanFrame) -> DecodedFrame | None:
    for group in robot.groups:
        if group.bus == frame.bus:
            decoded = group.driver.decode(frame)
            if decoded is not None:
                return decoded
    return None


def _words(robot: Robot, frame: CanFrame) -> tuple[str | None, str]:
    raw = f"{frame.bus} {frame.id:0{8 if frame.extended else 3}X}#{frame.data.hex().upper()}"
    decoded = _decode(robot, frame)
    if decoded is None:
        return None, raw
    values = " ".join(f"{name}={value:g}" for name, value in decoded.fields)
    return decoded.motor, f"{decoded.message} {values} ({raw})"
