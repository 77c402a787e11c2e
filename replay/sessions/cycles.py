"""From the blocks of one segment to cycles: checked, ordered, and turned into the values they were.

How this works
--------------
Blocks are unpacked at once, which is cheap: a column is an array. Every cycle whose check does not fit its values is
left out and named. Only then, a window of cycles at a time, columns become Python values.
"""

import gc
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise, repeat
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drivers.contract import CanFrame
from gateway.recording.block import DAMAGED, Block, unpacked
from gateway.recording.packets import Gap
from gateway.recording.schema import (
    BLOCK_COLUMNS,
    BLOCK_PATH,
    COUNTERS,
    CYCLE,
    EVENTS,
    FRAMES_IN,
    FRAMES_OUT,
    INPUTS,
    OUTPUTS,
    SEAL_COLUMNS,
    SEAL_PATH,
    SNAPSHOT_COLUMNS,
    SNAPSHOT_PATH,
    Kind,
    Table,
)
from gateway.types import CycleTiming, Event, Inputs, Mode, Odometry, Outputs, Reply
from replay.sessions.tables import Layout, Tables

WINDOW = (
    512  # cycles turned into Python values at a time: a batch at 1 kHz whole; many more are slower, by the collector
)
SPOILT = "not as it was written"
LAYOUT: Layout = {
    BLOCK_PATH: {CYCLE: None, **BLOCK_COLUMNS},
    SEAL_PATH: SEAL_COLUMNS,
    SNAPSHOT_PATH: SNAPSHOT_COLUMNS,
}

Integers = npt.NDArray[np.int64]
_MODES = {mode.value: mode for mode in Mode}


class RecordedOutputs(NamedTuple):
    """What the core said in a cycle, as far as a replay must say the same."""

    frames: tuple[CanFrame, ...]
    mode: Mode
    events: tuple[Event, ...]
    replies: tuple[Reply, ...]
    odometry: Odometry | None

    @classmethod
    def of(cls, outputs: Outputs) -> "RecordedOutputs":
        """The part of fresh outputs that compares with a recording."""
        return cls(outputs.frames, outputs.mode, outputs.events, outputs.replies, outputs.odometry)


COMPARED = len(RecordedOutputs._fields)  # the first fields of Outputs
assert Outputs._fields[:COMPARED] == RecordedOutputs._fields
Cycle = tuple[Inputs, RecordedOutputs]


class Packed(NamedTuple):
    """A block as it lies in a segment, and what the row that it lies in says of it."""

    first_cycle: int
    cycles: int
    block: bytes


class Window(NamedTuple):
    """Some cycles in ascending order, whose values are made when they are asked for."""

    first_cycle: int
    values: Callable[[], Iterable[Cycle]]


class Sketch(NamedTuple):
    """Of some cycles in ascending order what needs no value of every row: for a survey of a session."""

    cycle: Integers
    now_ns: Integers
    modes: list[str]
    events: list[tuple[int, Event]]  # each with the time of its cycle
    frames_received: int
    frames_sent: int


class _Run(NamedTuple):
    """Cycles of a block next to each other, all of them whole or none."""

    block: Block
    start: int
    end: int
    whole: bool

    @property
    def cycle(self) -> Integers:
        return self.block.cycles.numbers("cycle")[self.start : self.end]


class Seen(NamedTuple):
    """Which cycles are as they were written, in order, and which are there and are not."""

    cycle: Integers
    damaged: list[Gap]


class CycleRows:
    """The cycles of some blocks of a segment that are as they were written.

    `damaged`: those that are not. A window raises KeyError, TypeError or ValueError where values are of no known kind.
    """

    def __init__(self, blocks: Iterable[Packed]) -> None:
        self.damaged: list[Gap] = []
        runs = [run for block in self._unpacked(blocks) for run in _runs(block)]
        self._runs = sorted((run for run in runs if run.whole), key=lambda run: int(run.cycle[0]))
        self.cycle: Integers = np.concatenate([np.empty(0, np.int64), *(run.cycle for run in self._runs)])
        spoilt = [run.cycle for run in runs if not run.whole]
        self.damaged += [Gap(int(cycle.min()), int(cycle.max()), SPOILT) for cycle in spoilt]

    def _unpacked(self, blocks: Iterable[Packed]) -> Iterator[Block]:
        for first, count, block in blocks:
            try:
                yield unpacked(block)
            except DAMAGED:
                self.damaged.append(Gap(first, first + count - 1, SPOILT))

    @property
    def seen(self) -> Seen:
        """What there is, without its values."""
        return Seen(self.cycle, self.damaged)

    def windows(self) -> Iterator[Window]:
        """All of the cycles, some at a time."""
        for run in self._runs:
            for start in range(run.start, run.end, WINDOW):
                yield _window(run.block, start, min(start + WINDOW, run.end))

    def sketches(self) -> Iterator[Sketch]:
        """All of the cycles, a block or a part of one at a time. Raises as a window does."""
        for run in self._runs:
            yield _sketch(run)

    def timings(self) -> Iterator[tuple[int, CycleTiming]]:
        """How the loop kept time, by the number of the cycle."""
        for block, start, end, _ in self._runs:
            columns = (block.cycles.column(name, Kind.INT, start, end) for name in COUNTERS[4:])
            numbers = block.cycles.column(COUNTERS[0], Kind.INT, start, end)
            yield from zip(numbers, map(CycleTiming, *columns), strict=True)


def made(window: Window) -> list[Cycle]:
    """The values of a window. Raises as they do."""
    collecting = gc.isenabled()
    gc.disable()  # there are no circles in them, and looking for some takes a fifth of the time
    try:
        return list(window.values())
    finally:
        if collecting:
            gc.enable()


def blocks_of(tables: Tables) -> list[Packed]:
    """The blocks of a segment, from its columns by entity path."""
    columns = tables.get(BLOCK_PATH)
    if columns is None:
        return []
    rows = (columns[CYCLE], columns["count"].flatten(), columns["block"].flatten())
    return [Packed(*row) for row in zip(*(row.to_pylist() for row in rows), strict=True)]


def first_spoilt(packed: Packed) -> int:
    """The first cycle of a block whose values do not fit its check; the first of all if there is none, or no block."""
    try:
        block = unpacked(packed.block)
    except DAMAGED:
        return packed.first_cycle
    spoilt = np.flatnonzero(~block.whole)
    return int(block.cycles.numbers("cycle")[spoilt[0]]) if spoilt.size else packed.first_cycle


def rows_of(tables: Tables) -> CycleRows:
    """The cycles of a segment, from its columns by entity path."""
    return CycleRows(blocks_of(tables))


def count(tables: Tables) -> int:
    """How many cycles there are, the damaged ones among them."""
    columns = tables.get(BLOCK_PATH)
    return 0 if columns is None else int(sum(columns["count"].flatten().to_pylist()))


def _runs(block: Block) -> Iterator[_Run]:
    """Also ended where cycles do not ascend, which no recorder writes."""
    descends = np.diff(block.cycles.numbers("cycle")) <= 0
    borders = (np.flatnonzero(np.diff(block.whole) | descends) + 1).tolist()
    for start, end in pairwise([0, *borders, len(block.whole)]):
        if start < end:
            yield _Run(block, start, end, bool(block.whole[start]))


def sketched(window: Window) -> Sketch:
    """The same of cycles that are in no block. Raises as the window does."""
    found = made(window)
    return Sketch(
        np.array([inputs.cycle for inputs, _ in found], np.int64),
        np.array([inputs.now_ns for inputs, _ in found], np.int64),
        [outputs.mode.value for _, outputs in found],
        [(inputs.now_ns, event) for inputs, outputs in found for event in outputs.events],
        sum(len(inputs.frames) for inputs, _ in found),
        sum(len(outputs.frames) for _, outputs in found),
    )


def _sketch(run: _Run) -> Sketch:
    block, start, end, _ = run
    received, sent = (int(block.tables[table.name].counts[start:end].sum()) for table in (FRAMES_IN, FRAMES_OUT))
    now_ns = block.cycles.numbers("now_ns")[start:end]
    events = _groups(block, EVENTS, start, end)
    told = [(int(now_ns[place]), event) for place, some in enumerate(events) for event in some]
    return Sketch(run.cycle, now_ns, block.cycles.column("mode", Kind.TEXT, start, end), told, received, sent)


def _window(block: Block, start: int, end: int) -> Window:
    return Window(int(block.cycles.numbers("cycle")[start]), lambda: _values(block, start, end))


def _values(block: Block, start: int, end: int) -> Iterator[Cycle]:
    head = block.cycles
    cycle, now, overruns, dropped = (head.column(name, Kind.INT, start, end) for name in COUNTERS[:4])
    modes = map(_MODES.__getitem__, head.column("mode", Kind.TEXT, start, end))
    inputs = (_groups(block, table, start, end) for table in INPUTS)
    frames, events, replies, odometry = (_groups(block, table, start, end) for table in OUTPUTS)
    due = [values[0] if values else None for values in odometry]
    new = tuple.__new__  # not the call of Python that a named tuple makes of itself
    asked = map(new, repeat(Inputs), zip(cycle, now, *inputs, overruns, dropped, strict=True))
    return zip(
        asked, map(new, repeat(RecordedOutputs), zip(frames, modes, events, replies, due, strict=True)), strict=True
    )


def _groups(block: Block, table: Table, start: int, end: int) -> list[tuple[Any, ...]]:
    """One tuple of values per cycle."""
    columns = block.tables[table.name]
    counts, ends = columns.counts[start:end], columns.ends[start:end]
    first, last = int(ends[0] - counts[0]), int(ends[-1])
    groups: list[tuple[Any, ...]] = [()] * (end - start)
    if first == last:
        return groups
    values = columns.values(table, first, last)
    each = int(counts[0])
    if each and bool((counts == each).all()):  # as a bus that keeps its time has it
        return list(zip(*[iter(values)] * each, strict=True))
    if last - first >= len(groups):
        return [values[a:b] for a, b in pairwise([0, *(ends - first).tolist()])]
    there = np.flatnonzero(counts)
    for place, a, b in zip(
        there.tolist(), *((ends - less)[there].tolist() for less in (first + counts, first)), strict=True
    ):
        groups[place] = values[a:b]
    return groups
