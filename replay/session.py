"""Opens a recorded session: its header, its gaps, and every cycle in order, exactly as it was.

How this works
--------------
A session is read segment by segment. A segment that was not closed, or is damaged, is cut back to its whole messages;
the session then says `complete = False`, and what is missing shows up in `gaps`.
"""

import tempfile
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

from gateway.record import Gap
from gateway.session_schema import (
    GAP_COLUMNS,
    GAP_PATH,
    HEADER_PATH,
    INPUT_CYCLE,
    INPUTS,
    OUTPUT_CYCLE,
    OUTPUTS,
    SCHEMA_VERSION,
    Header,
)
from gateway.types import Inputs
from replay.cycles import Columns, CycleRows, Integers, RecordedOutputs
from replay.repair import has_footer, repair

__all__ = ["RecordedOutputs", "Session", "SessionError", "open_session"]

WINDOW = 256  # cycles turned into Python values at a time; more is slower, for the sake of the garbage collector
_CONTENT = [*(entity.path for entity in (*INPUTS, *OUTPUTS, INPUT_CYCLE, OUTPUT_CYCLE)), GAP_PATH]
_DAMAGED = (KeyError, IndexError, OverflowError, TypeError, ValueError)  # pyarrow's own errors are among them

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
        if not segments:
            raise SessionError(f"{path}: not a session: there is no segment-*.rrd in it")
        for segment in segments:
            header = _header(segment)
            if header is not None:
                return Session(path, segments, header)
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from None
    raise SessionError(f"{path}: not a session of DriveGate: it has no header")


def _header(path: Path) -> Header | None:
    columns = _read(path, [HEADER_PATH])[0].get(HEADER_PATH)
    if columns is None:
        return None
    try:
        version, text = (columns[name].flatten()[0].as_py() for name in ("schema_version", "json"))
        if version != SCHEMA_VERSION:
            raise SessionError(
                f"{path}: has session schema {version}; this version of DriveGate reads {SCHEMA_VERSION}"
            )
        return msgspec.json.decode(text, type=Header)
    except _DAMAGED as error:
        raise SessionError(f"{path}: damaged header: {error!r}") from None


def _window(rows: CycleRows, start: int, path: Path) -> list[tuple[Inputs, RecordedOutputs]]:
    try:
        return list(rows.window(start, start + WINDOW))
    except _DAMAGED as error:
        raise SessionError(f"{path}: damaged near cycle {rows.cycle[start]}: {error!r}") from None


def _row_count(path: Path, entity: str) -> int:
    columns = _read(path, [entity])[0].get(entity)
    return 0 if columns is None else max(len(column) for column in columns.values())


def _read(path: Path, content: Sequence[str]) -> tuple[Tables, bool]:
    """These entities of a segment, and whether the file was whole. Raises SessionError, OSError."""
    whole = has_footer(path)
    try:
        if not whole:
            return _tables(_unclosed(path, content)), False
        return _tables(RrdReader(path).store().stream().filter(content=list(content))), True
    except (RuntimeError, *_DAMAGED):
        return _repaired(path, content), False


def _repaired(path: Path, content: Sequence[str]) -> Tables:
    """The same from a copy that is cut back to its whole messages."""
    with tempfile.TemporaryDirectory(prefix="drivegate-") as folder:
        copy = Path(folder) / path.name
        try:
            repair(path, copy)
            return _tables(_unclosed(copy, content))
        except (RuntimeError, *_DAMAGED) as error:
            raise SessionError(f"{path}: damaged beyond repair: {error}") from None


def _unclosed(path: Path, content: Sequence[str]) -> Iterable[Chunk]:
    """Chunks of a file without a footer; none if it was cut before it said what it is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there is no footer is what `complete` says
        reader = RrdReader(path)
        return reader.stream().filter(content=list(content)) if reader.recordings() else ()


def _tables(chunks: Iterable[Chunk]) -> Tables:
    """Columns by their own names, without the archetype that Rerun puts in front."""
    batches: dict[str, list[pa.RecordBatch]] = {}
    for chunk in chunks:
        batches.setdefault(str(chunk.entity_path), []).append(chunk.to_record_batch())
    return {
        entity: {
            name.rpartition(":")[2]: pa.concat_arrays([batch.column(name) for batch in found])
            for name in found[0].schema.names
        }
        for entity, found in batches.items()
    }


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
