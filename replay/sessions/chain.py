"""Whether what a segment holds is what was recorded, by its digest chain (`gateway.recording.chain`).

How this works
--------------
A batch is as it was recorded if the value beside it follows from its bytes and the value in front of it; nothing was
taken out, put in or exchanged if that value in front is the one of the link before. Behind damage, which is said
anyway, the second cannot be asked, the first can. From segment to segment it goes on in the header.
"""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from gateway.recording.chain import beginning, link
from gateway.recording.schema import BLOCK_PATH, CYCLE, SEAL_PATH, SNAPSHOT_PATH
from replay.sessions.cycles import Packed, first_spoilt
from replay.sessions.tables import Columns, Tables

ALTERED = "not as they were recorded: they do not fit the digest chain"
EXCHANGED = "something was taken out, put in or exchanged: it does not fit the digest chain"


class Break(NamedTuple):
    """Where the chain breaks: the first cycle that is not proven, and in words."""

    cycle: int
    words: str


class Chained(NamedTuple):
    """What the chain of a segment says.

    `before`: the value that its header tells; `values`: all there are, that of its header first; `end`: that of its
    seal. `intact`: nothing but its end may be missing. `cycle`: the first of its links.
    """

    before: bytes | None
    values: tuple[bytes, ...]
    end: bytes | None
    intact: bool
    cycle: int
    broken: Break | None


class _Link(NamedTuple):
    number: int
    cycles: int
    stored: bytes
    before: bytes
    chain: bytes

    @property
    def first_cycle(self) -> int:
        return self.number if self.cycles else self.number + 1


def judged(tables: Tables, header: str, before: str | None, *, intact: bool) -> Chained:
    """Of a segment, from its columns by entity path and its header as it is written. Raises ValueError."""
    value = beginning(header)
    values, broken, last_cycle, first_cycle = [value], None, -1, None
    for one in _links(tables):
        if link(one.before, one.number, one.cycles, one.stored) != one.chain:
            broken = broken or _altered(one)
        elif intact and one.before != value:
            broken = broken or Break(one.first_cycle, f"in front of cycle {one.first_cycle} {EXCHANGED}")
        value = one.chain
        values.append(value)
        first_cycle = one.first_cycle if first_cycle is None else first_cycle
        last_cycle = one.first_cycle + one.cycles - 1
    end = _end(tables.get(SEAL_PATH))
    if end is not None and intact and end != value:
        broken = broken or Break(last_cycle + 1, f"behind cycle {last_cycle} {EXCHANGED}")
    told = None if before is None else bytes.fromhex(before)
    return Chained(told, tuple(values), end, intact, first_cycle or 0, broken)


def goes_on(before: Chained | None, known: frozenset[bytes | None] | None) -> frozenset[bytes | None] | None:
    """The values with which the next segment may begin; None: any. `known`: those with which this one might.

    One that is closed leads to the next. One whose recorder died does, or one of its batches: the last that the service
    has heard of, which may also lie before it.
    """
    if before is None or not before.intact:
        return None
    if before.end is not None:
        return frozenset([before.end])
    return frozenset(before.values) | (known or frozenset())


def _altered(one: _Link) -> Break:
    if not one.cycles:
        return Break(one.first_cycle, f"the state of the core in front of cycle {one.first_cycle} is {ALTERED}")
    last = one.number + one.cycles - 1
    return Break(
        first_spoilt(Packed(one.number, one.cycles, one.stored)), f"cycles {one.number} to {last} are {ALTERED}"
    )


def _links(tables: Tables) -> Iterator[_Link]:
    """As they follow each other in the file."""
    snapshots = deque(_rows(tables.get(SNAPSHOT_PATH), "after", None, "state"))
    for batch in _rows(tables.get(BLOCK_PATH), CYCLE, "count", "block"):
        while snapshots and snapshots[0].number < batch.number:
            yield snapshots.popleft()
        yield batch
    yield from snapshots


def _rows(columns: Columns | None, number: str, cycles: str | None, stored: str) -> Iterator[_Link]:
    if columns is None:
        return
    cells = (number, cycles, stored, "before", "chain")
    lists = [[0] * len(columns[number]) if cell is None else _list(columns, cell) for cell in cells]
    yield from map(_Link, *lists)


def _list(columns: Columns, name: str) -> list[int] | list[bytes]:
    column = columns[name]
    values: list[int] | list[bytes] = (column if name == CYCLE else column.flatten()).to_pylist()
    return values


def _end(columns: Columns | None) -> bytes | None:
    return None if columns is None else bytes(columns["chain"].flatten()[-1].as_py())
