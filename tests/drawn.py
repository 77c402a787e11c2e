"""What is drawn in a Rerun file, as plain values: for tests that hold one drawing against another."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

from gateway.recording.schema import CYCLE, STATUS_PATH, WALL

Drawn = dict[str, dict[int, list[str]]]  # rows in words (in which NaN equals NaN), by entity and cycle, in order
STATIC = -1


def drawn(files: Iterable[Path]) -> Drawn:
    """Everything that people see: static cells are of the cycle -1 and of the first file."""
    found: Drawn = {}
    for number, path in enumerate(files):
        for chunk in RrdReader(path).store().stream():
            entity = str(chunk.entity_path)
            if entity.startswith("/trace") or entity in {STATUS_PATH, "/config"}:
                _take(found.setdefault(entity, {}), chunk.to_record_batch(), first=number == 0)
    return found


def _take(rows: dict[int, list[str]], batch: Any, *, first: bool) -> None:  # noqa: ANN401  # pyarrow has no types
    names = sorted(name for name in batch.schema.names if ":" in name or name in {CYCLE, WALL})
    static = CYCLE not in names
    if static and not first:
        return
    # Nanoseconds as they are: only pandas has a time of that resolution.
    columns = [batch.column(name).cast("int64") if name == WALL else batch.column(name) for name in names]
    for row in zip(*(column.to_pylist() for column in columns), strict=True):
        cells = dict(zip(names, row, strict=True))
        rows.setdefault(STATIC if static else cells[CYCLE], []).append(repr(cells))
