"""From the Arrow batches of a segment to columns of a layout; a batch that is not as it was written is left out."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from gateway.recording.schema import Kind
from replay.sessions.framing import Found

Column = Any  # an Arrow array, one list cell per row
Columns = Mapping[str, Column]  # of one entity, by name
Tables = Mapping[str, Columns]  # by entity path
Layout = Mapping[str, Mapping[str, Kind | None]]  # by entity path and column; None: a timeline

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


def tables_of(found: Found, layout: Layout) -> tuple[Tables, bool]:
    """Columns by entity, and whether every batch was as the recorder writes it."""
    tables: dict[str, Columns] = {}
    intact = True
    for entity, batches in found.batches.items():
        columns = _joined(batches, layout[entity])
        if columns is None:  # at least one batch is not as it was written: look at each of them
            intact = False
            columns = _joined([batch for batch in batches if _joined([batch], layout[entity])], layout[entity])
        if columns is not None:
            tables[entity] = columns
    return tables, intact


def _joined(batches: Sequence[pa.RecordBatch], layout: Mapping[str, Kind | None]) -> Columns | None:
    """The columns by their own names, without the archetype in front; None if they are not as they were written."""
    wanted = {name: pa.int64() if kind is None else pa.list_(_TYPES[kind]) for name, kind in layout.items()}
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


def _absent(parts: Mapping[str, Sequence[pa.Array]], layout: Mapping[str, Kind | None]) -> list[str]:
    """Columns that an older recorder did not write yet: nothing was said there."""
    return [name for name, kind in layout.items() if kind in _MAYBE and not parts[name]]


def _fits(column: Column, kind: Kind | None) -> bool:
    """One value per row; none at all only where nothing may be said."""
    if kind is None:
        return not column.null_count
    if column.null_count or column.flatten().null_count:
        return False
    cells = column.value_lengths().to_numpy()
    return kind is Kind.FLOATS or bool(np.all((cells == 1) | ((cells == 0) & (kind in _MAYBE))))
