"""One column of a block: how values of each kind are stored, checked and read, each value exactly.

How this works
--------------
Numbers stand byte plane by byte plane: first the lowest byte of every row, then the next ones. Upper bytes hardly
change from row to row, so Rerun's LZ4, which knows runs but no arithmetic, leaves little of them. Integers are
differences to the row before; texts are places in a list of the different ones. Whatever is unpacked was a stranger's:
lengths and places that do not fit are a ValueError, never an index beyond the data.
"""

import zlib
from array import array
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from gateway.recording.schema import Kind

Integers = npt.NDArray[np.int64]
Bits = npt.NDArray[np.uint64]
Parts = Sequence[bytes]

_encode = msgspec.msgpack.Encoder().encode
_words = msgspec.msgpack.Decoder(list[str])
_SHORT = 8  # bytes of data that stand in planes
_FACTORS = np.array([0x9E3779B97F4A7C15, 0xD6E8FEB86659FD93, 0xC2B2AE3D27D4EB4F], np.uint64)  # odd: no bit is lost
_SHIFT = np.uint64(32)


class Cells(Protocol):
    """One column of some rows."""

    def parts(self) -> list[bytes]:
        """As it is stored."""
        ...

    def bits(self) -> Bits:
        """A number for each row that any change of its value changes."""
        ...

    def values(self, start: int, end: int) -> list[Any]:
        """What it holds, from row to row."""
        ...


class Numbers:
    """Integers, floats or truth values. `array`: little-endian, 1, 4 or 8 bytes each."""

    def __init__(self, numbers: npt.NDArray[Any]) -> None:
        self.array = numbers

    def parts(self) -> list[bytes]:
        return [planes(_differences(self.array) if self.array.dtype == np.int64 else self.array)]

    def bits(self) -> Bits:
        return self.array.view(f"u{self.array.itemsize}").astype(np.uint64)

    def values(self, start: int, end: int) -> list[Any]:
        numbers: list[Any] = self.array[start:end].tolist()
        return numbers


class _Maybe:
    """Cells with a value or without; without one it counts as nothing and not as the zero that is stored."""

    def __init__(self, there: npt.NDArray[np.bool_], numbers: Numbers) -> None:
        self._there = there
        self._numbers = numbers

    def parts(self) -> list[bytes]:
        return [planes(self._there), *self._numbers.parts()]

    def bits(self) -> Bits:
        return np.where(self._there, self._numbers.bits(), _FACTORS[0]) + self._there

    def values(self, start: int, end: int) -> list[Any]:
        there = self._there[start:end]
        if not there.any():
            return [None] * len(there)
        numbers = self._numbers.values(start, end)
        if there.all():
            return numbers
        return [number if here else None for here, number in zip(there.tolist(), numbers, strict=True)]


class _Texts:
    """Few different texts, many rows. `places` in the list of `words`, -1 for None."""

    def __init__(self, places: npt.NDArray[np.int32], words: list[str]) -> None:
        self._places = places
        self._table: list[str | None] = [*words, None]

    def parts(self) -> list[bytes]:
        return [planes(self._places), _encode(self._table[:-1])]

    def bits(self) -> Bits:
        codes = [zlib.crc32(word.encode()) + 1 for word in self._table if word is not None]
        return np.array([*codes, 0], np.uint64)[self._places]

    def values(self, start: int, end: int) -> list[Any]:
        return list(map(self._table.__getitem__, self._places[start:end].tolist()))


class _Data:
    """Short pieces of bytes: the first eight in planes, what goes beyond behind them."""

    def __init__(self, lengths: npt.NDArray[np.uint8], heads: Bits, tail: bytes) -> None:
        self._lengths = lengths
        self._heads = heads
        self._tail = tail
        beyond = np.maximum(lengths.astype(np.int64) - _SHORT, 0)
        self._ends = np.cumsum(beyond)
        if (self._ends[-1] if len(lengths) else 0) != len(tail):
            raise ValueError("the lengths do not fit the data")

    def parts(self) -> list[bytes]:
        return [planes(self._lengths), planes(self._heads), self._tail]

    def bits(self) -> Bits:
        codes: Bits = self._heads * _FACTORS[1] + self._lengths
        for row in np.flatnonzero(self._lengths > _SHORT).tolist():
            codes[row] += np.uint64(zlib.crc32(self._beyond(row)))
        return codes

    def values(self, start: int, end: int) -> list[Any]:
        lengths = self._lengths[start:end]
        heads: list[bytes] = self._heads[start:end].view("V8").tolist()
        for row in np.flatnonzero(lengths != _SHORT).tolist():
            heads[row] = heads[row][: lengths[row]] + self._beyond(start + row)
        return heads

    def _beyond(self, row: int) -> bytes:
        end = int(self._ends[row])
        return self._tail[end - max(int(self._lengths[row]) - _SHORT, 0) : end]


class _Lists:
    """Any number of floats in each row."""

    def __init__(self, lengths: Integers, numbers: Numbers) -> None:
        self._lengths = Numbers(lengths)
        self._numbers = numbers
        self._ends = np.cumsum(lengths)
        size = len(numbers.array)
        # Each by itself too: sums of lengths beyond all measure wrap around, and may fit again.
        if (self._ends[-1] if len(lengths) else 0) != size or bool(((lengths < 0) | (lengths > size)).any()):
            raise ValueError("the lengths do not fit the numbers")

    def parts(self) -> list[bytes]:
        return [*self._lengths.parts(), *self._numbers.parts()]

    def bits(self) -> Bits:
        lengths = self._lengths.array
        return sums([self._numbers.bits()], lengths) + self._lengths.bits()

    def values(self, start: int, end: int) -> list[Any]:
        lengths, ends = self._lengths.values(start, end), self._ends[start:end].tolist()
        return [tuple(self._numbers.values(last - length, last)) for length, last in zip(lengths, ends, strict=True)]


def planes(numbers: npt.NDArray[Any]) -> bytes:
    return np.ascontiguousarray(numbers.view(np.uint8).reshape(len(numbers), numbers.itemsize).T).tobytes()


def _differences(numbers: Integers) -> Bits:
    """To the row before, as unsigned numbers, which wrap around."""
    unsigned = numbers.view(np.uint64)
    return np.diff(unsigned, prepend=np.uint64(0))


def unplaned(stored: bytes, kind: str, rows: int) -> npt.NDArray[Any]:
    flat = np.frombuffer(stored, np.uint8).reshape(np.dtype(kind).itemsize, rows)
    return np.ascontiguousarray(flat.T).reshape(-1).view(kind)


def _packed_numbers(code: str) -> Callable[[Sequence[Any]], Numbers]:
    """Of Python's values; array takes no float for an integer, nor a number too large (TypeError, OverflowError)."""
    return lambda values: Numbers(np.frombuffer(array(code, values), np.dtype(code)))


def _unpacked_numbers(kind: str) -> Callable[[Parts, int], Numbers]:
    return lambda parts, rows: Numbers(unplaned(parts[0], kind, rows))


def _unpacked_integers(parts: Parts, rows: int) -> Numbers:
    return Numbers(np.cumsum(unplaned(parts[0], "<u8", rows), dtype=np.uint64).view(np.int64))


def _unpacked_bools(parts: Parts, rows: int) -> Numbers:
    numbers = unplaned(parts[0], "u1", rows)
    if bool((numbers > 1).any()):
        raise ValueError("neither true nor false")
    return Numbers(numbers.view(np.bool_))


def _packed_maybe(pack: Callable[[Sequence[Any]], Numbers]) -> Callable[[Sequence[Any]], _Maybe]:
    def packed(values: Sequence[Any]) -> _Maybe:
        there = np.array([value is not None for value in values], np.bool_)
        return _Maybe(there, pack([0 if value is None else value for value in values]))

    return packed


def _unpacked_maybe(unpack: Callable[[Parts, int], Numbers]) -> Callable[[Parts, int], _Maybe]:
    def unpacked(parts: Parts, rows: int) -> _Maybe:
        there = _unpacked_bools(parts[:1], rows).array
        return _Maybe(there, unpack(parts[1:], rows))

    return unpacked


def _packed_texts(*, none: bool) -> Callable[[Sequence[Any]], _Texts]:
    def packed(values: Sequence[Any]) -> _Texts:
        known: dict[str, int] = {}
        places = [-1 if none and value is None else known.setdefault(value, len(known)) for value in values]
        if not all(isinstance(word, str) and word.encode() is not None for word in known):
            raise TypeError("not a text")
        return _Texts(np.array(places, np.int32), list(known))

    return packed


def _unpacked_texts(*, none: bool) -> Callable[[Parts, int], _Texts]:
    def unpacked(parts: Parts, rows: int) -> _Texts:
        places, words = unplaned(parts[0], "<i4", rows), _words.decode(parts[1])
        if rows and (places.max() >= len(words) or places.min() < (-1 if none else 0)):
            raise ValueError("no such text")
        return _Texts(places, words)

    return unpacked


def _packed_data(values: Sequence[bytes]) -> _Data:
    lengths = np.frombuffer(array("B", map(len, values)), np.uint8)
    heads = np.frombuffer(b"".join([value[:_SHORT].ljust(_SHORT, b"\0") for value in values]), np.uint64)
    return _Data(lengths, heads, b"".join([value[_SHORT:] for value in values]) if (lengths > _SHORT).any() else b"")


def _unpacked_data(parts: Parts, rows: int) -> _Data:
    return _Data(unplaned(parts[0], "u1", rows), unplaned(parts[1], "<u8", rows), parts[2])


def _packed_lists(values: Sequence[Sequence[float]]) -> _Lists:
    lengths = np.array([len(value) for value in values], np.int64)
    return _Lists(lengths, _packed_numbers("d")(list(chain.from_iterable(values))))


def _unpacked_lists(parts: Parts, rows: int) -> _Lists:
    lengths = _unpacked_integers(parts[:1], rows).array
    return _Lists(lengths, _unpacked_numbers("<f8")(parts[1:], len(parts[1]) // 8))


class Coding(NamedTuple):
    pack: Callable[[Sequence[Any]], Cells]
    unpack: Callable[[Parts, int], Cells]
    absent: Any  # what a column reads as that is not in the block


def _bools(values: Sequence[Any]) -> Numbers:
    return Numbers(_packed_numbers("B")(values).array.view(np.bool_))


CODINGS: dict[Kind, Coding] = {
    Kind.INT: Coding(_packed_numbers("q"), _unpacked_integers, 0),
    Kind.ID: Coding(_packed_numbers("I"), _unpacked_numbers("<u4"), 0),
    Kind.FLOAT: Coding(_packed_numbers("d"), _unpacked_numbers("<f8"), 0.0),
    Kind.BOOL: Coding(_bools, _unpacked_bools, False),
    Kind.TEXT: Coding(_packed_texts(none=False), _unpacked_texts(none=False), ""),
    Kind.BINARY: Coding(_packed_data, _unpacked_data, b""),
    Kind.FLOATS: Coding(_packed_lists, _unpacked_lists, ()),
    Kind.MAYBE_INT: Coding(_packed_maybe(_packed_numbers("q")), _unpacked_maybe(_unpacked_integers), None),
    Kind.MAYBE_FLOAT: Coding(_packed_maybe(_packed_numbers("d")), _unpacked_maybe(_unpacked_numbers("<f8")), None),
    Kind.MAYBE_TEXT: Coding(_packed_texts(none=True), _unpacked_texts(none=True), None),
}


def sums(columns: Sequence[Bits], counts: Integers, salt: np.uint64 = _FACTORS[2]) -> Bits:
    """The sum over the rows of each group of a number that is another one when a value, or its place, is another."""
    total = int(counts.sum())
    starts = np.cumsum(counts) - counts
    place = (np.arange(total) - np.repeat(starts, counts)).astype(np.uint64)
    mixed = place * _FACTORS[2] + salt
    for bits in columns:
        mixed = mixed * _FACTORS[0] + bits
        mixed ^= mixed >> _SHIFT
    mixed *= _FACTORS[1]
    mixed ^= mixed >> _SHIFT
    running = np.zeros(total + 1, np.uint64)
    np.cumsum(mixed, out=running[1:])
    of_groups: Bits = running[starts + counts] - running[starts]
    return of_groups
