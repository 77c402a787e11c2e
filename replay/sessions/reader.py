"""Opens a recorded session: its header, its gaps, and every cycle in order, exactly as it was.

How this works
--------------
A session is read segment by segment, of each segment what is whole. Nothing that is missing or damaged ends the
reading: it is said in `problems`, and cycles that are not there show up in `gaps`. A session is complete when all of
it is provably there: from its first cycle without a gap, every segment in its place, closed, and equal to its seal, the
last one sealed as final, and every cycle in the digest chain that begins with the header. Recordings from before there
were seals are taken at the word of their last footer.
"""

import hashlib
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from gateway.recording.disk import SUMS, noted_sums, segment_number, segments
from gateway.recording.packets import Gap, encode
from gateway.recording.schema import (
    GAP_COLUMNS,
    GAP_PATH,
    HEADER_COLUMNS,
    HEADER_PATH,
    SCHEMA_VERSION,
    SEAL_PATH,
    SNAPSHOT_PATH,
    Header,
)
from gateway.types import CycleTiming
from replay.sessions import cycles, version_1, version_2
from replay.sessions.chain import EXCHANGED, Break, Chained, goes_on, judged
from replay.sessions.cycles import Cycle, Integers, Packed, RecordedOutputs, Seen, Sketch, Window, made, sketched
from replay.sessions.framing import Found, checksum, digest, read
from replay.sessions.tables import Columns, Layout, Tables, tables_of

__all__ = ["RecordedOutputs", "Session", "SessionError", "Stretch", "open_session"]

_MARKS: Layout = {
    GAP_PATH: GAP_COLUMNS,
    HEADER_PATH: HEADER_COLUMNS,
}  # in every version
PROBLEMS_SHOWN = 3
UNMARKED = "not in the recording"
PRUNED = "deleted to make room"
_DAMAGED = (KeyError, IndexError, OverflowError, TypeError, ValueError, pa.ArrowException)
_NO_CYCLES: Integers = np.empty(0, np.int64)


Rows = cycles.CycleRows | version_1.CycleRows


class _Version(NamedTuple):
    """How cycles lie in the segments of a schema version."""

    layout: Layout
    rows: Callable[[Tables], Rows]
    count: Callable[[Tables], int]
    blocks: Callable[[Tables], Sequence[Packed]] | None  # None: there are none
    chained: bool


_VERSIONS = {
    1: _Version({**version_1.LAYOUT, **version_2.MARKS}, version_1.CycleRows, version_1.count, None, chained=False),
    2: _Version(version_2.LAYOUT, cycles.rows_of, cycles.count, cycles.blocks_of, chained=False),
    SCHEMA_VERSION: _Version(cycles.LAYOUT, cycles.rows_of, cycles.count, cycles.blocks_of, chained=True),
}


class SessionError(Exception):
    """A session that cannot be read; the text says which file and why."""


class _Seal(NamedTuple):
    """The columns of `SEAL_COLUMNS`, but for the chain."""

    bytes: int
    crc32: int
    first_segment: int
    final: bool
    last_cycle: int | None


class _Part(NamedTuple):
    """What is known of a segment once it was read."""

    cycles: Integers
    markers: list[Gap]
    problems: list[str]
    first_segment: int = 1
    seal: _Seal | None = None
    chained: Chained | None = None

    def read(self, seen: Seen) -> "_Part":
        """The same once more of its cycles were read."""
        return self._replace(cycles=np.concatenate([self.cycles, seen.cycle]), markers=[*self.markers, *seen.damaged])


class Stretch(NamedTuple):
    """Cycles of a segment from one snapshot of the core to the next, unread: plain bytes, for another process.

    First and last cycle: by what the segment says of its blocks. `snapshots`: those in front of its cycles and among
    them, packed, by the cycle after which they were taken.
    """

    path: Path
    first_cycle: int
    last_cycle: int
    blocks: Sequence[Packed]
    snapshots: Mapping[int, bytes]

    def snapshot(self, cycle: int) -> dict[str, Any] | None:
        """The state of the core after this cycle, if it was recorded there."""
        return _state(self.snapshots.get(cycle))


class Session:
    """An opened session; see `open_session`."""

    def __init__(self, path: Path, files: Sequence[Path], header: Header) -> None:
        self.path = path
        self.segments = tuple(files)
        self.header = header
        self._version = _VERSIONS[header.schema_version]
        self._layout = {**_MARKS, **self._version.layout}
        self._parts: dict[Path, _Part] = {}
        self._snapshots: dict[int, bytes] = {}

    @property
    def config_text(self) -> str:
        """The robot file as it was driven with."""
        return self.header.config_text

    @property
    def cycle_count(self) -> int:
        """How many cycles there are to read, give or take the incomplete ones of a damaged segment."""
        counts = (
            len(self._parts[segment].cycles) if segment in self._parts else _count(segment, self._version)
            for segment in self.segments
        )
        return sum(counts)

    @property
    def complete(self) -> bool:
        """Whether everything is provably there; reads what has not been iterated yet."""
        return not self.problems

    @property
    def problems(self) -> tuple[str, ...]:
        """What is missing or damaged, in words; reads what has not been iterated yet."""
        parts = self._all_parts()
        found = [f"{path.name}: {one.words}" for path, one in self._breaks()]
        found += [f"{path.name}: {problem}" for path in self.segments for problem in parts[path].problems]
        found += self._missing_segments()
        found += map(_gap_in_words, self.gaps)
        last = parts[self.segments[-1]].seal
        if self.header.sealed and (last is None or not last.final):
            found.append("the session was not ended in order: its last cycles may be missing")
        return tuple(found)

    @property
    def first_unproven(self) -> int | None:
        """The first cycle that is missing or not provably as it was recorded; None if all of them are."""
        cycles = [one.cycle for _, one in self._breaks()] + [gap.first_cycle for gap in self.gaps]
        parts = self._all_parts()
        last = parts[self.segments[-1]].seal
        if self.header.sealed and (last is None or not last.final):
            cycles.append(1 + max((int(part.cycles[-1]) for part in parts.values() if part.cycles.size), default=-1))
        return min(cycles, default=None)

    @property
    def problem(self) -> str | None:
        """The first of the problems in one line; None if the session is complete."""
        problems = self.problems
        more = len(problems) - PROBLEMS_SHOWN
        return "; ".join(problems[:PROBLEMS_SHOWN]) + (f"; and {more} more" if more > 0 else "") or None

    @property
    def pruned(self) -> bool:
        """Whether the beginning was deleted by the recorder to make room."""
        parts = self._all_parts()
        return 1 < self._numbers()[0] <= max(part.first_segment for part in parts.values())

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Cycles that are missing, in order; reads what has not been iterated yet."""
        parts = self._all_parts().values()
        cycles = np.unique(np.concatenate([part.cycles for part in parts]))
        markers = [marker for part in parts for marker in part.markers]
        first = self.header.first_cycle
        if self.pruned and cycles.size and cycles[0] > first:
            markers.insert(0, Gap(first, int(cycles[0]) - 1, PRUNED))
        seal = self._parts[self.segments[-1]].seal
        return tuple(_gaps(cycles, markers, first, seal.last_cycle if seal is not None else None))

    def cycles(self) -> Iterator[Cycle]:
        """Every recorded cycle in order, none twice."""
        last = -1
        for path in self.segments:
            for window in self._load(path).windows():
                found = self._values(window, path)
                if found and window.first_cycle <= last:
                    found = [cycle for cycle in found if cycle[0].cycle > last]
                yield from found
                last = found[-1][0].cycle if found else last

    def sketches(self) -> Iterator[Sketch]:
        """A survey of every recorded cycle, in order; of cycles that are there twice the first segment's."""
        last = -1
        for path in self.segments:
            for sketch in self._sketches(path):
                if sketch.cycle.size and sketch.cycle[0] > last:
                    last = int(sketch.cycle[-1])
                    yield sketch

    def _sketches(self, path: Path) -> Iterator[Sketch]:
        rows = self._load(path)
        try:
            yield from rows.sketches() if isinstance(rows, cycles.CycleRows) else map(sketched, rows.windows())
        except _DAMAGED as error:
            self._parts[path].problems.append(f"it is damaged: {error!r}")

    def snapshot(self, cycle: int) -> dict[str, Any] | None:
        """The state of the core after this cycle, if it was recorded there and that segment has been read."""
        return _state(self._snapshots.get(cycle))

    @property
    def snapshots(self) -> Mapping[int, bytes]:
        """All of them in the segments that have been read, packed, by the cycle after which they were taken."""
        return self._snapshots

    def timings(self) -> Iterator[tuple[int, CycleTiming]]:
        """How the loop kept time in each cycle, by its number. Raises SessionError of a recording of schema 1."""
        for path in self.segments:
            rows = self._load(path)
            if not isinstance(rows, cycles.CycleRows):
                raise SessionError(f"{path}: has session schema 1, of which this is not read")
            yield from rows.timings()

    @property
    def divisible(self) -> bool:
        """Whether it can be had in stretches."""
        return self._version.blocks is not None

    def again(self) -> "Session":
        """The same session, of which nothing was read yet."""
        return Session(self.path, self.segments, self.header)

    def stretches(self) -> Iterator[Stretch]:
        """All of it to be read elsewhere; what was found there is given back with `settle`."""
        if self._version.blocks is None:
            return
        for path in self.segments:
            tables, self._parts[path] = self._opened(path)
            for blocks in _stretches(self._version.blocks(tables), self._snapshots):
                first, last = blocks[0].first_cycle, blocks[-1].first_cycle + blocks[-1].cycles - 1
                near = {after: state for after, state in self._snapshots.items() if first - 1 <= after <= last}
                yield Stretch(path, first, last, blocks, near)

    def settle(self, stretch: Stretch, seen: Seen) -> None:
        """What was found in a stretch."""
        self._parts[stretch.path] = self._parts[stretch.path].read(seen)

    def _values(self, window: Window, path: Path) -> list[Cycle]:
        try:
            return made(window)
        except _DAMAGED as error:
            self._parts[path].problems.append(f"it is damaged near cycle {window.first_cycle}: {error!r}")
            return []

    def _all_parts(self) -> Mapping[Path, _Part]:
        for path in self.segments:
            if path not in self._parts:
                self._load(path)
        return self._parts

    def _numbers(self) -> list[int]:
        """Of the segments by their names; a file of another name counts as what its header says."""
        return [segment_number(path) or self.header.segment for path in self.segments]

    def _missing_segments(self) -> list[str]:
        """Numbers that are not there, except the first ones where the recorder says that it deleted them."""
        numbers = self._numbers() if self.pruned else [0, *self._numbers()]
        return [
            f"segments {before + 1} to {number - 1} are missing"
            for before, number in pairwise(numbers)
            if number > before + 1
        ]

    def _breaks(self) -> Iterator[tuple[Path, Break]]:
        """Where the digest chain breaks: the first place in each segment, and in front of it."""
        parts, numbers = self._all_parts(), self._numbers()
        known: frozenset[bytes | None] | None = frozenset([None])
        for path, number, expected in zip(self.segments, numbers, [1, *(one + 1 for one in numbers)], strict=False):
            chained = parts[path].chained
            known = known if number == expected else None
            if chained is not None and known is not None and chained.before not in known:
                yield path, Break(chained.cycle, f"in front of cycle {chained.cycle} {EXCHANGED}")
            elif chained is not None and chained.broken is not None:
                yield path, chained.broken
            known = goes_on(chained, known)

    def _load(self, path: Path) -> Rows:
        """Read a segment; what cannot be read of it is a problem of the session."""
        tables, part = self._opened(path)
        try:
            rows = self._version.rows(tables)
            part = part.read(Seen(rows.cycle, rows.damaged))
        except _DAMAGED as error:
            rows, part = self._version.rows({}), _unread(f"it cannot be read: {error}")
        if path not in self._parts:
            self._parts[path] = part
        return rows

    def _opened(self, path: Path) -> tuple[Tables, _Part]:
        """Everything of a segment but its cycles."""
        try:
            return self._examined(path, read(path, self._layout))
        except SessionError as error:
            return {}, _unread(str(error).removeprefix(f"{path}: "))
        except OSError as error:
            return {}, _unread(f"it cannot be read: {error.strerror}")
        except _DAMAGED as error:
            return {}, _unread(f"it cannot be read: {error}")

    def _examined(self, path: Path, found: Found) -> tuple[Tables, _Part]:
        """Raises one of _DAMAGED, OSError, SessionError."""
        tables, intact = tables_of(found, self._layout)
        problems = [found.problem] if found.problem else []
        if not intact and not problems:
            problems.append("it is damaged")
        header, seal = _header_in(path, tables), _seal_in(tables)
        if header is not None and header.session != self.header.session:
            raise SessionError(f"{path}: it belongs to session {header.session}")
        if header is None:
            problems.append("it has no header")
        elif header.segment != (segment_number(path) or header.segment):
            problems.append(f"it is segment {header.segment} by its header")
        if self.header.sealed and not problems:
            problems += _seal_problems(path, seal, found) or _sum_problems(path)
        snapshots, whole = _snapshots(tables.get(SNAPSHOT_PATH))
        self._snapshots |= snapshots
        if not whole:
            problems.append("a snapshot of the core is not as it was written")
        first = max(header.first_segment if header else 1, seal.first_segment if seal else 1)
        chained = None
        if header is not None and self._version.chained:
            chained = judged(tables, _header_text(tables), header.chain, intact=intact and found.intact)
        return tables, _Part(_NO_CYCLES, _markers(tables.get(GAP_PATH)), problems, first, seal, chained)


def open_session(path: Path) -> Session:
    """Open a session folder or a single segment. Raises SessionError."""
    try:
        files = segments(path) if path.is_dir() else [path]
        headers, problems = _headers(files)
        if headers:
            return Session(path, files, headers[0])
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from None
    if not files:
        raise SessionError(f"{path}: not a session: there is no segment-*.rrd in it")
    raise problems[0] if problems else SessionError(f"{path}: not a session of DriveGate: it has no header")


def packed(state: object) -> bytes:
    """A snapshot of the core as the recorder packs it."""
    return encode(state)


def _state(packed_state: bytes | None) -> dict[str, Any] | None:
    if packed_state is None:
        return None
    try:
        state: dict[str, Any] = msgspec.msgpack.decode(packed_state, type=dict)
    except ValueError:
        return None
    return state


def _unread(problem: str) -> _Part:
    return _Part(_NO_CYCLES, [], [problem])


def _stretches(blocks: Iterable[Packed], snapshots: Collection[int]) -> Iterator[list[Packed]]:
    """Blocks in groups, each but the first with a snapshot in front of it."""
    group: list[Packed] = []
    for block in blocks:
        if group and block.first_cycle - 1 in snapshots:
            yield group
            group = []
        group.append(block)
    if group:
        yield group


def _headers(files: Sequence[Path]) -> tuple[list[Header], list[SessionError]]:
    """The first header that can be read, and what is wrong with those before it."""
    problems: list[SessionError] = []
    for file in files:
        try:
            header = _header(file)
        except SessionError as error:
            problems.append(error)
            continue
        if header is not None:
            return [header], problems
    return [], problems


def _header(path: Path) -> Header | None:
    return _header_in(path, _read(path, {HEADER_PATH: HEADER_COLUMNS}, first_only=True))


def _header_text(tables: Tables) -> str:
    return str(tables[HEADER_PATH]["json"].flatten()[0].as_py())


def _header_in(path: Path, tables: Tables) -> Header | None:
    columns = tables.get(HEADER_PATH)
    if columns is None:
        return None
    try:
        version, text = columns["schema_version"].flatten()[0].as_py(), _header_text(tables)
        if version not in _VERSIONS:
            known = " and ".join(map(str, _VERSIONS))
            raise SessionError(f"{path}: has session schema {version}; this version of DriveGate reads {known}")
        header = msgspec.json.decode(text, type=Header)
    except _DAMAGED as error:
        raise SessionError(f"{path}: damaged header: {error!r}") from None
    if hashlib.sha256(header.config_text.encode()).hexdigest() != header.config_sha256:
        raise SessionError(f"{path}: damaged header: the robot file in it does not match its checksum")
    return header


def _seal_in(tables: Tables) -> _Seal | None:
    columns = tables.get(SEAL_PATH)
    if columns is None:
        return None
    *numbers, last_cycle = (columns[name][-1].as_py() for name in _Seal._fields)
    length, crc32, first_segment, final = (cell[0] for cell in numbers)
    return _Seal(length, crc32, first_segment, final, last_cycle[0] if last_cycle else None)


def _seal_problems(path: Path, seal: _Seal | None, found: Found) -> list[str]:
    """Whether a closed segment is what was sealed."""
    if seal is None:
        return ["its seal is missing"]
    if found.places[SEAL_PATH] != seal.bytes or checksum(path, seal.bytes) != seal.crc32:
        return ["it is not as it was written: it does not fit its seal"]
    return []


def _sum_problems(path: Path) -> list[str]:
    """Whether a closed segment is, to the last byte, what was noted; where nothing was noted its seal must do."""
    try:
        noted = noted_sums(path.parent)
    except OSError as error:
        return [f"{SUMS} cannot be read: {error.strerror}"]
    if noted is None:
        return []
    if path.name not in noted:  # an incident may be older than that they are noted, or be a copy among others
        return [] if segment_number(path) is None else [f"it is not in {SUMS}"]
    return [] if digest(path) == noted[path.name] else [f"it is not as it was written: it does not fit {SUMS}"]


def _count(path: Path, version: _Version) -> int:
    try:
        return version.count(_read(path, version.layout))
    except SessionError:
        return 0


def _read(path: Path, layout: Layout, *, first_only: bool = False) -> Tables:
    """Columns of these entities of a segment. Raises SessionError."""
    try:
        found = read(path, layout, first_only=first_only)
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise SessionError(f"{path}: {error}") from None
    return tables_of(found, layout)[0]


def _markers(columns: Columns | None) -> list[Gap]:
    """The gaps as the recorder marked them."""
    if columns is None:
        return []
    values = (columns[name].flatten().to_pylist() for name in GAP_COLUMNS)
    return [Gap(*row) for row in zip(*values, strict=True)]


def _snapshots(columns: Columns | None) -> tuple[dict[int, bytes], bool]:
    """Those that are as they were written, and whether all are."""
    if columns is None:
        return {}, True
    rows = list(zip(*(columns[name].flatten().to_pylist() for name in ("after", "state", "crc32")), strict=True))
    whole = {after: state for after, state, crc32 in rows if zlib.crc32(state) == crc32}
    return whole, len(whole) == len(rows)


def _gaps(cycles: Integers, markers: Sequence[Gap], first: int, last_cycle: int | None) -> Iterator[Gap]:
    """What is missing: cycles skipped from the first on, marked ones behind all that are, and those up to the last."""
    places = np.flatnonzero(np.diff(cycles, prepend=first - 1) > 1).tolist()
    for place in places:
        begin, end = int(cycles[place - 1]) + 1 if place else first, int(cycles[place]) - 1
        reasons = [m.reason for m in markers if m.first_cycle <= end and m.last_cycle >= begin]
        yield Gap(begin, end, "; ".join(dict.fromkeys(reasons)) or UNMARKED)
    last = int(cycles[-1]) if cycles.size else first - 1
    for marker in markers:
        if marker.last_cycle > last:
            yield Gap(max(marker.first_cycle, last + 1), marker.last_cycle, marker.reason)
            last = marker.last_cycle
    if last_cycle is not None and last_cycle > last:
        yield Gap(last + 1, last_cycle, UNMARKED)


def _gap_in_words(gap: Gap) -> str:
    reason = "" if gap.reason == UNMARKED else f" ({gap.reason})"
    return f"cycles {gap.first_cycle} to {gap.last_cycle} are missing from the recording{reason}"
