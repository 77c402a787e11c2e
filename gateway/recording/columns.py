"""From rows to the Arrow columns of an entity of Rerun's: exact values, None as an empty cell."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from gateway.recording.schema import CYCLE, WALL, Kind, Row


class Times:
    """The timelines of a batch, one value per cycle: its number, and CLOCK_REALTIME at its start (ns)."""

    def __init__(self, cycles: Sequence[int], wall_ns: Sequence[int]) -> None:
        self._cycles = np.array(cycles, np.int64)
        self._wall_ns = np.array(wall_ns, np.int64)

    def at(self, places: Sequence[int]) -> list[rr.TimeColumn]:
        """Times of rows that belong to the cycles at these places of the batch."""
        rows = np.array(places, np.int64)
        return [
            rr.TimeColumn(CYCLE, sequence=self._cycles[rows]),
            rr.TimeColumn(WALL, timestamp=self._wall_ns[rows].view("datetime64[ns]")),
        ]


def arrays(columns: Mapping[str, Kind], rows: Sequence[Row]) -> dict[str, pa.Array]:
    """One Arrow array per column."""
    values: Sequence[Sequence[Any]] = list(zip(*rows, strict=True)) or [()] * len(columns)
    return {name: _ARRAYS[kind](column) for (name, kind), column in zip(columns.items(), values, strict=True)}


def _plain(kind: pa.DataType) -> Callable[[Sequence[Any]], pa.Array]:
    return lambda values: pa.array(values, kind)


def _maybe(kind: pa.DataType) -> Callable[[Sequence[Any]], pa.Array]:
    """None becomes a cell of no value, which Rerun keeps apart from NaN, zero and the empty text."""

    def array(values: Sequence[Any]) -> pa.Array:
        offsets = np.zeros(len(values) + 1, np.int32)
        np.cumsum([value is not None for value in values], out=offsets[1:])
        present = pa.array([value for value in values if value is not None], kind)
        return pa.ListArray.from_arrays(pa.array(offsets), present)

    return array


_ARRAYS: dict[Kind, Callable[[Sequence[Any]], pa.Array]] = {
    Kind.INT: _plain(pa.int64()),
    Kind.BOOL: _plain(pa.bool_()),
    Kind.TEXT: _plain(pa.string()),
    Kind.BINARY: _plain(pa.binary()),
    Kind.MAYBE_INT: _maybe(pa.int64()),
}
