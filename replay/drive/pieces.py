"""A piece of a session as a session of its own, and pieces put together again.

How this works
--------------
A piece begins where the state of the core is known: with cycle 0, or behind a snapshot, which is in front of its first
cycle. Its header is that of the whole, and says where it begins and of what it is a piece; so it is complete if nothing
between its ends is missing, and verifies on its own. Inputs, outputs, times and snapshots are those that were recorded;
the pictures are drawn again, by the same core, so that cycles to which no snapshot leads cannot be in a piece.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import NamedTuple

import msgspec

from gateway.config import RobotConfig, parse
from gateway.recording.packets import Hello, Record, RecorderReport, Snapshot
from gateway.recording.recorder import RecorderError
from gateway.recording.schema import SCHEMA_VERSION, Header
from gateway.recording.writer import SessionWriter
from gateway.types import CycleTiming, Outputs
from replay.compare.replay import CRASHES, Replay
from replay.drive.recording import check_room, discard
from replay.sessions.cycles import Cycle
from replay.sessions.reader import Session, SessionError

UNLIMITED = 1 << 62  # bytes: nothing that lies in the directory is deleted for a piece
BATCH_S = 1.0


class Piece(NamedTuple):
    """What was written: the session, its first and last cycle, and when these were, s since the first of the whole."""

    session: Path
    first_cycle: int
    last_cycle: int
    begin: float
    end: float


class _Span(NamedTuple):
    first_cycle: int
    last_cycle: int
    first_ns: int
    last_ns: int


def cut(session: Session, directory: Path, *, begin: float = 0.0, end: float = inf) -> Piece:
    """Make a session of what is between two times, s since the first recorded cycle, and of what leads to it.

    Raises SessionError, ConfigError, RecorderError, WriterDeadError, OSError.
    """
    span, origin_ns = _span(session, begin, end)
    folder = _write([session], span, directory)
    since = [round((ns - origin_ns) * 1e-9, 6) for ns in (span.first_ns, span.last_ns)]
    return Piece(folder, span.first_cycle, span.last_cycle, *since)


def merge(sessions: Sequence[Session], directory: Path) -> Piece:
    """Put pieces of one session together, in the order of their cycles.

    Raises SessionError, ConfigError, RecorderError, WriterDeadError, OSError.
    """
    _check_same([session.header for session in sessions])
    spans = sorted(zip((_whole_span(session) for session in sessions), range(len(sessions)), strict=True))
    for (one, place), (other, next_place) in pairwise(spans):
        if other.first_cycle > one.last_cycle + 1:
            names = f"{sessions[place].path} and {sessions[next_place].path}"
            raise SessionError(f"between {names} cycles {one.last_cycle + 1} to {other.first_cycle - 1} are missing")
    first, last = spans[0][0], max((span for span, _ in spans), key=lambda span: span.last_cycle)
    span = _Span(first.first_cycle, last.last_cycle, first.first_ns, last.last_ns)
    folder = _write([sessions[place] for _, place in spans], span, directory)
    return Piece(folder, span.first_cycle, span.last_cycle, 0.0, round((span.last_ns - span.first_ns) * 1e-9, 6))


def _check_same(headers: Sequence[Header]) -> None:
    """Two robots of one name that start in the same second have sessions of one name. Raises SessionError."""
    wholes = {header.cut_from or header.session for header in headers}
    if len(wholes) > 1:
        raise SessionError(f"these are not pieces of one session, but of {', '.join(sorted(wholes))}")
    for what, tell in _THE_SAME.items():
        if len({tell(header) for header in headers}) > 1:
            raise SessionError(f"these are pieces of two sessions called {wholes.pop()}: they differ in the {what}")


_THE_SAME: Mapping[str, Callable[[Header], object]] = {  # in every piece of one session
    "host": lambda header: header.host,
    "start of the clock": lambda header: header.wall_minus_mono_ns,
    "robot file": lambda header: header.config_text,
}


def _whole_span(session: Session) -> _Span:
    return _span(session, 0.0, inf)[0]


def _span(session: Session, begin: float, end: float) -> tuple[_Span, int]:
    """The cycles of a piece and the time from which `begin` and `end` count. Raises SessionError."""
    origin_ns = None
    times: dict[int, int] = {}
    for sketch in session.sketches():
        origin_ns = int(sketch.now_ns[0]) if origin_ns is None else origin_ns
        times.update(zip(sketch.cycle.tolist(), sketch.now_ns.tolist(), strict=True))
    low, high = begin * 1e9 - 0.5, end * 1e9 + 0.5  # a time may have been rounded when it was shown
    wanted = [cycle for cycle, ns in times.items() if low <= ns - (origin_ns or 0) <= high]
    if end < begin:
        raise SessionError(f"from {begin:g} s to {end:g} s: the end is in front of the beginning")
    if not wanted or origin_ns is None:
        raise SessionError(f"{session.path}: no cycle was recorded from {begin:g} s to {end:g} s")
    first = _known(session, times, wanted[0])
    last = wanted[-1]
    for cycle in range(first, last + 1):
        if cycle not in times:
            raise SessionError(
                f"{session.path}: cycle {cycle} is missing: a piece ends in front of it or begins behind it"
            )
    return _Span(first, last, times[first], times[last]), origin_ns


def _known(session: Session, times: Mapping[int, int], wanted: int) -> int:
    """The last cycle up to the wanted one in front of which the state of the core is known. Raises SessionError."""
    first = wanted
    while first > 0 and first - 1 not in session.snapshots:
        first -= 1
        if first not in times:
            raise SessionError(f"{session.path}: no snapshot of the core leads to cycle {wanted}")
    return first


def _write(sessions: Sequence[Session], span: _Span, directory: Path) -> Path:
    """Raises SessionError, ConfigError, RecorderError, WriterDeadError, OSError."""
    whole = sessions[0]
    header = whole.header
    if header.schema_version != SCHEMA_VERSION:
        raise SessionError(f"{whole.path}: has session schema {header.schema_version}, of which no piece can be made")
    config = parse(header.config_text, "robot file of the session")
    limits = config.recording.model_copy(update={"directory": str(directory), "disk_budget": UNLIMITED, "min_free": 0})
    started_ns = span.first_ns + header.wall_minus_mono_ns
    told = msgspec.structs.replace(
        header,
        started_wall_ns=started_ns,
        sealed=True,
        first_cycle=span.first_cycle,
        cut_from=header.cut_from or header.session,
        incident=None,
    )
    hello = Hello("", header.config_text, header.config_origin, None, started_ns, header.wall_minus_mono_ns)
    writer = SessionWriter(config.model_copy(update={"recording": limits}), hello, told=told)
    try:
        for batch, snapshot in _batches(sessions, span, config):
            check_room(writer.folder)
            writer.write(batch, (), snapshot)
        writer.close()
        _check_whole(writer.report())
    except BaseException as why:
        discard(writer, why)
        raise
    return writer.folder


def _check_whole(report: RecorderReport) -> None:
    """Raises RecorderError."""
    if report.lost:
        raise RecorderError(f"{report.folder}: {report.lost} cycles could not be written: {report.error}")


def _batches(
    sessions: Sequence[Session], span: _Span, config: RobotConfig
) -> Iterator[tuple[list[Record], Snapshot | None]]:
    """Cycles in batches, each that a snapshot was in front of with it."""
    snapshots = {cycle: state for session in sessions for cycle, state in session.snapshots.items()}
    batch: list[Record] = []
    size = max(round(BATCH_S * config.loop.rate), 1)
    front: Snapshot | None = None
    for record in _records(sessions, span, config):
        before = record.inputs.cycle - 1
        if batch and (before in snapshots or len(batch) >= size):
            yield batch, front
            batch, front = [], None
        if not batch and before in snapshots:
            front = Snapshot(before, snapshots[before])
        batch.append(record)
    if batch:
        yield batch, front


def _records(sessions: Sequence[Session], span: _Span, config: RobotConfig) -> Iterator[Record]:
    """What was recorded, with what is drawn of it. Raises SessionError."""
    timings = dict(_timings(sessions, span))
    snapshots: list[Callable[[int], dict[str, object] | None]] = [session.snapshot for session in sessions]
    replay = Replay(config, lambda cycle: next(filter(None, (known(cycle) for known in snapshots)), None))
    for inputs, recorded in _cycles(sessions, span):
        engine = replay.engine(inputs)
        if engine is None:
            raise SessionError(f"cycle {inputs.cycle}: the snapshot in front of it is of no use: {replay.refused}")
        try:
            outputs = engine.step(inputs)
        except CRASHES as error:
            raise SessionError(f"cycle {inputs.cycle}: this version of the software breaks on it: {error!r}") from None
        yield Record(inputs, Outputs(*recorded, outputs.status, outputs.trace, outputs.finished), timings[inputs.cycle])


def _cycles(sessions: Iterable[Session], span: _Span) -> Iterator[Cycle]:
    """Each cycle of a span once."""
    following = span.first_cycle
    for session in sessions:
        for cycle in session.cycles():
            if following <= cycle[0].cycle <= span.last_cycle:
                following = cycle[0].cycle + 1
                yield cycle


def _timings(sessions: Iterable[Session], span: _Span) -> Iterator[tuple[int, CycleTiming]]:
    for session in sessions:
        for number, timing in session.timings():
            if span.first_cycle <= number <= span.last_cycle:
                yield number, timing
