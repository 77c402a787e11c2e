"""Opens a recorded session: its header, its gaps, and every cycle in order, exactly as it was.

How this works
--------------
A session is read segment by segment, of each segment what is whole: if it was not closed, or is damaged, the session
says `complete = False`, and the cycles that are missing show up in `gaps`.
"""

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa

from gateway.record import Gap
from gateway.session_schema import (
    CYCLE,
    GAP_COLUMNS,
    GAP_PATH,
    HEADER_COLUMNS,
    HEADER_PATH,
    INDEX,
    INPUT_CYCLE,
    INPUTS,
    OUTPUT_CYCLE,
    OUTPUTS,
    SCHEMA_VERSION,
    Header,
    Kind,
)
from gateway.types import Inputs
from replay.cycles import Column, Columns, CycleRows, Integers, RecordedOutputs
from replay.repair import has_footer, read

__all__ = ["RecordedOutputs", "Session", "SessionError", "open_session"]

WINDOW = 256  # cycles turned into Python values at a time; more is slower, for the sake of the garbage collector
_LAYOUT: Mapping[str, Mapping[str, Kind]] = {
    **{entity.path: {**entity.columns, INDEX: Kind.ID} for entity in (*INPUTS, *OUTPUTS, INPUT_CYCLE, OUTPUT_CYCLE)},
    GAP_PATH: GAP_COLUMNS,
    HEADER_PATH: HEADER_COLUMNS,
}
_CONTENT = frozenset(_LAYOUT) - {HEADER_PATH}
_MAYBE = {Kind.MAYBE_INT, Kind.MAYBE_FLOAT, Kind.MAYBE_TEXT}
_TYPES = {
    Kind.INT: pa.int64(),
    Kind.ID: pa.uint32(),
    Kind.FLOAT: pa.float64(),
    Kind.BOOL: pa.bool_(),
    Kind.TEXT: pa.string(),
    Kind.BINARY: pa.binary(),
    Kind.FLOATS: pa.float64(),
    Kind.MAYBE_INT: pa.int64(),
    Kind.MAYBE_FLOAT: pa.float64(),
    Kind.MAYBE_TEXT: pa.string(),
}
_DAMAGED = (KeyError, IndexError, OverflowError, TypeError, ValueError, pa.ArrowException)

Tables = dict[str, Columns]  # by entity path


class SessionError(Exception):
    """A session that cannot be read; the text says which file and why."""


class Session:
    """An opened session; see `open_session`. `complete`: every segment read so far was closed and is whole."""

    def __init__(self, path: Path, segments: Sequence[Path], header: Header) -> None:
        self.path = path
        self.segments = tuple(segments)
        self.header = header
        self.complete = all(has_footer(segment) for segment in segments)
        self._seen: dict[Path, tuple[Integers, list[Gap]]] = {}

    @property
    def config_text(self) -> str:
        """The robot file as it was driven with."""
        return self.header.config_text

    @property
    def cycle_count(self) -> int:
        """How many cycles there are to read, give or take the incomplete ones of a damaged segment."""
        counts = (
            len(self._seen[segment][0]) if segment in self._seen else _row_count(segment, OUTPUT_CYCLE.path)
            for segment in self.segments
        )
        return sum(counts)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Cycles that are missing, in order; reads what has not been iterated yet. Raises SessionError."""
        for path in self.segments:
            if path not in self._seen:
                self._load(path)
        cycles = np.unique(np.concatenate([cycles for cycles, _ in self._seen.values()]))
        return tuple(_gaps(cycles, [marker for _, markers in self._seen.values() for marker in markers]))

    def cycles(self) -> Iterator[tuple[Inputs, RecordedOutputs]]:
        """Every recorded cycle in order, none twice. Raises SessionError."""
        last = -1
        for path in self.segments:
            rows = self._load(path)
            for start in range(0, len(rows.cycle), WINDOW):
                for inputs, outputs in _window(rows, start, path):
                    if inputs.cycle > last:
                        last = inputs.cycle
                        yield inputs, outputs

    def _load(self, path: Path) -> CycleRows:
        tables, whole = _read(path, _CONTENT)
        self.complete = self.complete and whole
        try:
            rows = CycleRows(tables)
            markers = _markers(tables.get(GAP_PATH))
        except _DAMAGED as error:
            raise SessionError(f"{path}: damaged: {error!r}") from None
        self._seen[path] = (rows.cycle, markers)
        return rows


def open_session(path: Path) -> Session:
    """Open a session folder or a single segment. Raises SessionError."""
    try:
        segments = sorted(path.glob("segment-*.rrd")) if path.is_dir() else [path]
        headers, problems = _headers(segments)
        if headers:
            return Session(path, segments, headers[0])
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from None
    if not segments:
        raise SessionError(f"{path}: not a session: there is no segment-*.rrd in it")
    raise problems[0] if problems else SessionError(f"{path}: not a session of DriveGate: it has no header")


def _headers(segments: Sequence[Path]) -> tuple[list[Header], list[SessionError]]:
    """The first header that can be read, and what is wrong with those before it."""
    problems: list[SessionError] = []
    for segment in segments:
        try:
            header = _header(segment)
        except SessionError as error:
            problems.append(error)
            continue
        if header is not None:
            return [header], problems
    return [], problems


def _header(path: Path) -> Header | None:
    columns = _read(path, [HEADER_PATH], first_only=True)[0].get(HEADER_PATH)
    if columns is None:
        return None
    try:
        version, text = (columns[name].flatten()[0].as_py() for name in ("schema_version", "json"))
        if version != SCHEMA_VERSION:
            raise SessionError(
                f"{path}: has session schema {version}; this version of DriveGate reads {SCHEMA_VERSION}"
            )
        header = msgspec.json.decode(text, type=Header)
    except _DAMAGED as error:
        raise SessionError(f"{path}: damaged header: {error!r}") from None
    if hashlib.sha256(header.config_text.encode()).hexdigest() != header.config_sha256:
        raise SessionError(f"{path}: damaged header: the robot file in it does not match its checksum")
    return header


def _window(rows: CycleRows, start: int, path: Path) -> list[tuple[Inputs, RecordedOutputs]]:
    try:
        return list(rows.window(start, start + WINDOW))
    except _DAMAGED as error:
        raise SessionError(f"{path}: damaged near cycle {rows.cycle[start]}: {error!r}") from None


def _row_count(path: Path, entity: str) -> int:
    columns = _read(path, [entity])[0].get(entity)
    return 0 if columns is None else len(columns[CYCLE])


def _read(path: Path, entities: Collection[str], *, first_only: bool = False) -> tuple[Tables, bool]:
    """Columns of these entities of a segment, and whether the file was whole. Raises SessionError."""
    try:
        found = read(path, entities, first_only=first_only)
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise SessionError(f"{path}: {error}") from None
    tables: Tables = {}
    whole = found.whole
    for entity, batches in found.batches.items():
        columns = _joined(batches, _LAYOUT[entity])
        if columns is None:  # at least one batch is not as it was written: look at each of them
            whole = False
            columns = _joined([batch for batch in batches if _joined([batch], _LAYOUT[entity])], _LAYOUT[entity])
        if columns is not None:
            tables[entity] = columns
    return tables, whole


def _joined(batches: Sequence[pa.RecordBatch], layout: Mapping[str, Kind]) -> Columns | None:
    """The columns by their own names, without the archetype in front; None if they are not as they were written."""
    wanted = {name: pa.list_(_TYPES[kind]) for name, kind in layout.items()}
    if layout is not HEADER_COLUMNS:
        wanted[CYCLE] = pa.int64()
    parts: dict[str, list[pa.Array]] = {name: [] for name in wanted}
    for batch in batches:
        for place, field in enumerate(batch.schema):
            name = field.name.rpartition(":")[2]
            if wanted.get(name) == field.type:
                parts[name].append(batch.column(place))
    for name in _absent(parts, layout):
        parts[name] = [pa.array([[]] * batch.num_rows, wanted[name]) for batch in batches]
    if not batches or any(len(found) != len(batches) for found in parts.values()):
        return None
    columns = {name: pa.concat_arrays(found) for name, found in parts.items()}
    return columns if all(_fits(columns[name], kind) for name, kind in layout.items()) else None


def _absent(parts: Mapping[str, Sequence[pa.Array]], layout: Mapping[str, Kind]) -> list[str]:
    """Columns that an older recorder did not write yet: nothing was said there."""
    return [name for name, kind in layout.items() if kind in _MAYBE and not parts[name]]


def _fits(column: Column, kind: Kind) -> bool:
    """One value per row; none at all only where nothing may be said."""
    if column.null_count or column.flatten().null_count:
        return False
    cells = column.value_lengths().to_numpy()
    return kind is Kind.FLOATS or bool(np.all((cells == 1) | ((cells == 0) & (kind in _MAYBE))))


def _markers(columns: Columns | None) -> list[Gap]:
    """The gaps as the recorder marked them."""
    if columns is None:
        return []
    values = (columns[name].flatten().to_pylist() for name in GAP_COLUMNS)
    return [Gap(*row) for row in zip(*values, strict=True)]


def _gaps(cycles: Integers, markers: Sequence[Gap]) -> Iterator[Gap]:
    """What is missing: cycles skipped between those that are there, and marked ones before and after all of them."""
    if not cycles.size:
        yield from markers
        return
    first, last = int(cycles[0]), int(cycles[-1])
    yield from (Gap(m.first_cycle, min(m.last_cycle, first - 1), m.reason) for m in markers if m.first_cycle < first)
    for place in np.flatnonzero(np.diff(cycles) > 1).tolist():
        begin, end = int(cycles[place]) + 1, int(cycles[place + 1]) - 1
        reasons = [m.reason for m in markers if m.first_cycle <= end and m.last_cycle >= begin]
        yield Gap(begin, end, "; ".join(dict.fromkeys(reasons)) or "not in the recording")
    yield from (Gap(max(m.first_cycle, last + 1), m.last_cycle, m.reason) for m in markers if m.last_cycle > last)
