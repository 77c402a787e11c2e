"""Recordings of schema version 1: a row of Rerun's for every frame, command and cycle. Read, no longer written.

How this works
--------------
The layout is this file's own and never changes again. `/inputs/cycle` and `/outputs/cycle` have one row per cycle.
The rows of every entity are put in the order of cycle and index (Rerun promises none) and matched with the counts of
the cycle rows. A cycle whose rows are not all there was not recorded whole and is left out. Only then, a window of
cycles at a time, columns become Python values.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise, repeat
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drivers.contract import CanFrame
from gateway.recording.packets import Gap
from gateway.recording.schema import CYCLE, Kind, Row
from gateway.types import (
    BusEvent,
    BusEventKind,
    Event,
    Inputs,
    Level,
    Mode,
    Odometry,
    Pose,
    Refusal,
    RefusalCode,
    Reply,
    Request,
    RequestKind,
    Twist,
    TwistCommand,
    TwistFrame,
)
from replay.sessions.cycles import WINDOW, Cycle, Integers, RecordedOutputs, Window
from replay.sessions.tables import Column, Columns, Layout, Tables

INDEX = "index"  # column of every entity: place of the row within its cycle
CAN_COLUMNS = {
    "bus": Kind.TEXT,
    "id": Kind.ID,
    "data": Kind.BINARY,
    "extended": Kind.BOOL,
    "remote": Kind.BOOL,
    "received_ns": Kind.MAYBE_INT,
}
_MODES = {mode.value: mode for mode in Mode}


class Entity(NamedTuple):
    """Where rows live, what they hold and how one becomes a value again."""

    path: str
    columns: Mapping[str, Kind]
    value: Callable[[Row], Any]


def _command(row: Row) -> TwistCommand:
    source, vx, vy, wz, frame, sequence, received_ns, sender, stamped = row
    return TwistCommand(source, Twist(vx, vy, wz), TwistFrame(frame), sequence, received_ns, sender, bool(stamped))


def _refusal(row: Row) -> Refusal:
    source, code, text, received_ns = row
    return Refusal(source, RefusalCode(code), text, received_ns)


def _request(row: Row) -> Request:
    kind, *rest = row
    return Request(RequestKind(kind), *rest)


def _bus_event(row: Row) -> BusEvent:
    bus, kind, occurrences, text = row
    return BusEvent(bus, BusEventKind(kind), occurrences, text)


def _event(row: Row) -> Event:
    level, code, text = row
    return Event(Level(level), code, text)


def _odometry(row: Row) -> Odometry:
    x, y, theta, vx, vy, wz, covariance, residual = row
    twist = None if vx is None else Twist(vx, vy, wz)
    return Odometry(Pose(x, y, theta), twist, tuple(covariance), residual)


# How many rows a cycle has in the other entities, in the order of INPUTS and OUTPUTS below.
INPUT_COUNTS = ("frames", "commands", "refusals", "requests", "bus_events")
OUTPUT_COUNTS = ("frames", "events", "replies", "odometry")

INPUT_CYCLE = Entity(
    "/inputs/cycle", dict.fromkeys(("now_ns", "overruns", "dropped_records", *INPUT_COUNTS), Kind.INT), tuple
)
OUTPUT_CYCLE = Entity(
    "/outputs/cycle",
    {"mode": Kind.TEXT, "finished": Kind.BOOL} | dict.fromkeys(OUTPUT_COUNTS, Kind.INT),
    tuple,
)
INPUTS = (
    Entity("/inputs/can", CAN_COLUMNS, lambda row: CanFrame(*row)),
    Entity(
        "/inputs/command",
        {"source": Kind.TEXT, "vx": Kind.FLOAT, "vy": Kind.FLOAT, "wz": Kind.FLOAT, "frame": Kind.TEXT}
        | {"sequence": Kind.MAYBE_INT, "received_ns": Kind.INT, "sender": Kind.MAYBE_TEXT, "stamped": Kind.MAYBE_INT},
        _command,
    ),
    Entity(
        "/inputs/refusal",
        {"source": Kind.TEXT, "code": Kind.TEXT, "text": Kind.TEXT, "received_ns": Kind.INT},
        _refusal,
    ),
    Entity(
        "/inputs/request",
        {"kind": Kind.TEXT, "id": Kind.INT, "received_ns": Kind.INT}
        | {"motor": Kind.MAYBE_TEXT, "angle": Kind.MAYBE_FLOAT},
        _request,
    ),
    Entity(
        "/inputs/bus",
        {"bus": Kind.TEXT, "kind": Kind.TEXT, "occurrences": Kind.INT, "text": Kind.TEXT},
        _bus_event,
    ),
)
OUTPUTS = (
    Entity("/outputs/can", CAN_COLUMNS, lambda row: CanFrame(*row)),
    Entity("/outputs/event", {"level": Kind.TEXT, "code": Kind.TEXT, "text": Kind.TEXT}, _event),
    Entity("/outputs/reply", {"id": Kind.INT, "ok": Kind.BOOL, "reason": Kind.MAYBE_TEXT}, Reply._make),
    Entity(
        "/outputs/odometry",
        {"x": Kind.FLOAT, "y": Kind.FLOAT, "theta": Kind.FLOAT}
        | dict.fromkeys(("vx", "vy", "wz"), Kind.MAYBE_FLOAT)
        | {"covariance": Kind.FLOATS, "residual": Kind.MAYBE_FLOAT},
        _odometry,
    ),
)
LAYOUT: Layout = {
    entity.path: {CYCLE: None, **entity.columns, INDEX: Kind.ID}
    for entity in (*INPUTS, *OUTPUTS, INPUT_CYCLE, OUTPUT_CYCLE)
}


def count(tables: Tables) -> int:
    """How many cycles there are, give or take the incomplete ones of a damaged segment."""
    columns = tables.get(OUTPUT_CYCLE.path)
    return 0 if columns is None else len(columns[CYCLE])


class CycleRows:
    """The cycles of a segment that were recorded whole, from its columns by entity path.

    Raises KeyError, IndexError, OverflowError, TypeError or ValueError, here and in its windows, on damaged columns.
    """

    def __init__(self, tables: Tables) -> None:
        self.damaged: list[Gap] = []
        inputs = _Rows(INPUT_CYCLE, tables.get(INPUT_CYCLE.path))
        outputs = _Rows(OUTPUT_CYCLE, tables.get(OUTPUT_CYCLE.path))
        cycle, at_inputs, at_outputs = np.intersect1d(inputs.cycle, outputs.cycle, return_indices=True)
        self._groups: list[_Group] = []
        whole = np.ones(len(cycle), bool)
        for entities, names, rows, places in (
            (INPUTS, INPUT_COUNTS, inputs, at_inputs),
            (OUTPUTS, OUTPUT_COUNTS, outputs, at_outputs),
        ):
            for entity, name in zip(entities, names, strict=True):
                group = _Group(_Rows(entity, tables.get(entity.path)), cycle)
                whole &= group.ends - group.starts == rows.numbers(name)[places]
                self._groups.append(group)
        for group in self._groups:
            group.keep(whole)
        self.cycle: Integers = cycle[whole]
        counters = ("now_ns", "overruns", "dropped_records")
        self._inputs = [inputs.numbers(name)[at_inputs[whole]] for name in counters]
        self._mode = outputs.texts("mode", at_outputs[whole])

    def windows(self) -> Iterator[Window]:
        """All of the cycles, some at a time."""
        for start in range(0, len(self.cycle), WINDOW):
            end = start + WINDOW
            yield Window(int(self.cycle[start]), lambda start=start, end=end: self._values(start, end))  # type: ignore[misc]

    def _values(self, start: int, end: int) -> Iterator[Cycle]:
        groups = [group.window(start, end) for group in self._groups]
        now, overruns, dropped = (column[start:end].tolist() for column in self._inputs)
        no_samples: Iterator[tuple[Any, ...]] = repeat(())
        given = (*groups[: len(INPUTS)], no_samples, overruns, dropped)
        inputs = map(Inputs, self.cycle[start:end].tolist(), now, *given)
        frames, events, replies, odometry = groups[len(INPUTS) :]
        modes = [_MODES[text] for text in self._mode[start:end]]
        due = [values[0] if values else None for values in odometry]
        return zip(inputs, map(RecordedOutputs, frames, modes, events, replies, due), strict=True)


class _Rows:
    """All rows of one entity in a segment, in the order of cycle and index, each once."""

    def __init__(self, entity: Entity, columns: Columns | None) -> None:
        self._entity = entity
        self._columns: Columns = {}
        self.cycle: Integers = np.empty(0, np.int64)
        if columns is None:
            return
        self._columns = {name: columns[name] for name in entity.columns}
        self.cycle = columns[CYCLE].to_numpy()
        self._put_in_order(columns[INDEX].flatten().to_numpy().astype(np.int64))

    def values(self, start: int, end: int) -> tuple[Any, ...]:
        """Rows as the values they were."""
        columns = [
            _LISTS[kind](self._columns[name].slice(start, end - start)) for name, kind in self._entity.columns.items()
        ]
        if self._entity.columns is CAN_COLUMNS:  # by far the most rows: made without a call of Python each
            classic = [False] * (end - start)  # neither of CAN FD nor with a bit rate switch
            return tuple(map(tuple.__new__, repeat(CanFrame), zip(*columns, classic, classic, strict=True)))
        return tuple(map(self._entity.value, zip(*columns, strict=True)))

    def numbers(self, name: str) -> Integers:
        """One integer column whole."""
        column = self._columns.get(name)
        return self.cycle if column is None else np.asarray(column.flatten(), np.int64)

    def texts(self, name: str, places: Integers) -> list[str]:
        """One text column at these places."""
        column = self._columns.get(name)
        return [] if column is None else _texts(column.take(places))

    def _put_in_order(self, index: Integers) -> None:
        steps = np.diff(self.cycle)
        if bool(np.all((steps > 0) | ((steps == 0) & (np.diff(index) > 0)))):
            return
        order = np.lexsort((index, self.cycle))
        keys = np.column_stack((self.cycle[order], index[order]))
        order = order[np.append([True], np.any(np.diff(keys, axis=0) != 0, axis=1))]
        self.cycle = self.cycle[order]
        self._columns = {name: column.take(order) for name, column in self._columns.items()}


class _Group:
    """The rows of one entity by cycle: where those of each cycle begin and end."""

    def __init__(self, rows: _Rows, cycle: Integers) -> None:
        self._rows = rows
        self.starts: Integers = np.searchsorted(rows.cycle, cycle, side="left")
        self.ends: Integers = np.searchsorted(rows.cycle, cycle, side="right")

    def keep(self, whole: npt.NDArray[np.bool_]) -> None:
        """Forget the cycles that are not whole."""
        self.starts, self.ends = self.starts[whole], self.ends[whole]

    def window(self, start: int, end: int) -> list[tuple[Any, ...]]:
        """One tuple of values per cycle."""
        starts, ends = self.starts[start:end], self.ends[start:end]
        if starts[0] == ends[-1]:
            return [()] * len(starts)
        first = int(starts[0])
        values = self._rows.values(first, int(ends[-1]))
        places = zip((starts - first).tolist(), (ends - first).tolist(), strict=True)
        return [values[a:b] for a, b in places]


def _numbers(column: Column) -> list[Any]:
    numbers: list[Any] = column.flatten().to_numpy(zero_copy_only=False).tolist()
    return numbers


def _texts(column: Column) -> list[Any]:
    """Few different texts, many rows."""
    coded = column.flatten().dictionary_encode()
    words = coded.dictionary.to_pylist()
    return [words[place] for place in coded.indices.to_numpy().tolist()]


def _binaries(column: Column) -> list[Any]:
    values = column.flatten()
    _, places, data = values.buffers()
    if data is None:
        return [b""] * len(values)
    offsets = np.frombuffer(places, np.int32)[values.offset : values.offset + len(values) + 1]
    first, last = int(offsets[0]), int(offsets[-1])
    flat = memoryview(data)[first:last].tobytes()
    return [flat[a:b] for a, b in pairwise((offsets - first).tolist())]


def _maybe(read: Callable[[Column], list[Any]]) -> Callable[[Column], list[Any]]:
    """Cells with a value or without."""

    def values(column: Column) -> list[Any]:
        there = column.value_lengths().to_numpy() > 0
        if not there.any():
            return [None] * len(column)
        present = iter(read(column))
        return [next(present) if here else None for here in there.tolist()] if not there.all() else list(present)

    return values


_LISTS: dict[Kind, Callable[[Column], list[Any]]] = {
    Kind.INT: _numbers,
    Kind.ID: _numbers,
    Kind.FLOAT: _numbers,
    Kind.BOOL: _numbers,
    Kind.TEXT: _texts,
    Kind.BINARY: _binaries,
    Kind.FLOATS: lambda column: column.to_pylist(),
    Kind.MAYBE_INT: _maybe(_numbers),
    Kind.MAYBE_FLOAT: _maybe(_numbers),
    Kind.MAYBE_TEXT: _maybe(_texts),
}
