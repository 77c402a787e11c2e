"""Segments as files, read without trust: every message is checked before anything is made of it.

How this works
--------------
A Rerun file is a stream header followed by messages, each with its kind and length in front, and closed by an end
message whose tail marks the footer. Messages carry no checksum, and Rerun's own reader ends the whole process on some
damaged ones (measured with 0.41: 4 of 6 files with flipped bits). So this walks over the messages itself: one is taken
when it lies within the file, is of a known kind and, if it holds Arrow data, unpacks, decodes and validates
completely. One that does not is left out, and its length is not believed: the walk goes on at the next place where a
whole message begins, so that no damage costs a message that it did not hit. The tail behind the end message says where
in the file that message began, so that a file from which bytes were taken is known as such even if what is left has all
the structure it should have.
Source: measured with rerun-sdk 0.41.0 (layout of the framing and of the ArrowMsg fields).
"""

import hashlib
import mmap
import re
import zlib
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from struct import Struct
from typing import NamedTuple

import pyarrow as pa

from gateway.recording.schema import FOOTER_MARK, FOOTER_TAIL

STREAM_HEADER_BYTES = 12  # "RRF2", version 4 bytes, compression, serializer, 2 reserved
MAGIC = b"RRF2"
_MESSAGE = Struct("<QQ")  # kind, payload length
_SCHEMA = Struct("<II")  # of an Arrow stream: mark, length of the schema that follows
_END, _STORE_INFO, _ARROW, _BLUEPRINT = range(4)
_BEGINNING = re.compile(rb"[\x01-\x03]\0{7}")  # how every message but the end begins
_FIELD_COMPRESSION, _FIELD_SIZE, _FIELD_BODY = 2, 3, 5
_LZ4 = 2
_LARGEST_BODY = 1 << 30  # a batch unpacked; more is a damaged length
_VARINT, _BYTES = 0, 2  # wire types of protobuf
_ENTITY = b"rerun:entity_path"
_DAMAGED = (KeyError, IndexError, TypeError, ValueError, OSError, MemoryError, pa.ArrowException)


class Kept(NamedTuple):
    """What a repair kept and dropped: whole messages; and from where to where in the file there are none."""

    messages: int
    dropped: tuple[tuple[int, int], ...]


class Found(NamedTuple):
    """Record batches by entity path, the place in the file of the last message of each, and what is wrong with it.

    `intact`: nothing in it is damaged but perhaps its end.
    """

    batches: dict[str, list[pa.RecordBatch]]
    places: dict[str, int]
    problem: str | None
    intact: bool


class _Message(NamedTuple):
    kind: int
    start: int
    end: int


class _Piece(NamedTuple):
    """A whole message, its entity and rows if they are wanted; or, of kind None, what belongs to no whole message."""

    kind: int | None
    start: int
    end: int
    entity: str = ""
    table: pa.Table | None = None


def read(path: Path, entities: Collection[str], *, first_only: bool = False) -> Found:
    """The whole messages of these entities. Raises ValueError if it is no Rerun file, OSError."""
    batches: dict[str, list[pa.RecordBatch]] = {}
    places: dict[str, int] = {}
    with path.open("rb") as file, _mapped(file.fileno(), path) as data:
        whole, intact, ended = data[: len(MAGIC)] == MAGIC, True, False
        for piece in _pieces(data, entities):
            whole &= piece.kind is not None
            intact &= piece.kind is not None or piece.end == len(data)
            ended |= piece.kind == _END and _is_in_place(data, piece)
            if piece.table is None:
                continue
            batches.setdefault(piece.entity, []).extend(piece.table.to_batches())
            places[piece.entity] = piece.start
            if first_only:
                break
        return Found(batches, places, _problem(data, ended=ended, whole=whole), intact)


def checksum(path: Path, length: int) -> int:
    """CRC-32 of so many bytes from the start of the file. Raises ValueError if it is no Rerun file, OSError."""
    with path.open("rb") as file, _mapped(file.fileno(), path) as data, memoryview(data) as view, view[:length] as part:
        return zlib.crc32(part)


def digest(path: Path) -> str:
    """SHA-256 of the whole file, hex. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def repair(source: Path, target: Path, progress: Callable[[int], None] = lambda _: None) -> Kept:
    """Write the whole messages of `source` to `target`, without an end: what followed them may be missing.

    `progress` is told how many more bytes are done. Raises ValueError if it is no Rerun file, OSError.
    """
    messages = 0
    dropped: list[tuple[int, int]] = []
    with source.open("rb") as file, _mapped(file.fileno(), source) as data, target.open("wb") as out:
        out.write(MAGIC + data[len(MAGIC) : STREAM_HEADER_BYTES])
        for piece in _pieces(data, None):
            if piece.kind is None:
                dropped.append((piece.start, piece.end))
            elif piece.kind != _END:
                out.write(data[piece.start : piece.end])
                messages += 1
            progress(piece.end - piece.start)
    return Kept(messages, tuple(dropped))


def _problem(data: mmap.mmap, *, ended: bool, whole: bool) -> str | None:
    """What is wrong with a file, from whether its end is in its place and all of its messages could be read."""
    if not ended:
        if FOOTER_MARK in data[-FOOTER_TAIL.size :]:
            return "it is not as it was written: bytes are missing, added or changed"
        return "it was not closed: its end may be missing"
    return None if whole else "it is damaged"


def _mapped(descriptor: int, path: Path) -> mmap.mmap:
    if path.stat().st_size >= STREAM_HEADER_BYTES:
        data = mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
        if data[: len(MAGIC)] == MAGIC or _whole_at(data, STREAM_HEADER_BYTES, None) is not None:
            return data
        data.close()
    raise ValueError("not a Rerun file")


def _pieces(data: mmap.mmap, entities: Collection[str] | None) -> Iterator[_Piece]:
    """The whole file in order, up to and with the end message: what is whole, and what is not."""
    last = _end(data)
    place = STREAM_HEADER_BYTES
    while place < len(data):
        if last is not None and place == last.start:
            yield _Piece(_END, last.start, len(data))
            return
        piece = _whole_at(data, place, entities)
        if piece is None:
            piece = _Piece(None, place, _next(data, place + 1, last))
        yield piece
        place = piece.end


def _end(data: mmap.mmap) -> _Message | None:
    """The end message, if it is of the length that the tail of the file says."""
    tail = data[-FOOTER_TAIL.size :]
    if len(tail) < FOOTER_TAIL.size:
        return None
    _, length, _, mark, _ = FOOTER_TAIL.unpack(tail)
    end = len(data) - FOOTER_TAIL.size
    start = end - length - _MESSAGE.size
    if mark != FOOTER_MARK or start < STREAM_HEADER_BYTES or _MESSAGE.unpack_from(data, start) != (_END, length):
        return None
    return _Message(_END, start, end)


def _is_in_place(data: mmap.mmap, end: _Piece) -> bool:
    """Whether the end message is where the tail says: nothing in front of it was taken out or added."""
    place, *_ = FOOTER_TAIL.unpack(data[-FOOTER_TAIL.size :])
    return bool(place == end.start + _MESSAGE.size)


def _next(data: mmap.mmap, place: int, last: _Message | None) -> int:
    """Where the next whole message begins from a place on; the end of the file if there is none."""
    end = len(data) if last is None or last.start < place else last.start
    for found in _BEGINNING.finditer(data, place, end):
        if _whole_at(data, found.start(), None) is not None:
            return found.start()
    return end


def _whole_at(data: mmap.mmap, place: int, entities: Collection[str] | None) -> _Piece | None:
    """The message at this place, if there is a whole one; with its rows if its entity is wanted (None: all are)."""
    if place + _MESSAGE.size > len(data):
        return None
    kind, length = _MESSAGE.unpack_from(data, place)
    end = place + _MESSAGE.size + length
    if kind not in {_STORE_INFO, _ARROW, _BLUEPRINT} or end > len(data):
        return None
    try:
        if kind == _ARROW:
            return _Piece(kind, place, end, *_decoded(data, _Message(kind, place, end), entities))
        fields = _fields(data[place + _MESSAGE.size : end])
        return _Piece(kind, place, end) if fields and _FIELD_BODY not in fields else None
    except _DAMAGED:
        return None


def _decoded(data: mmap.mmap, message: _Message, entities: Collection[str] | None) -> tuple[str, pa.Table | None]:
    """Entity path and rows; no rows if the entity is not among those wanted (None: all are)."""
    fields = _fields(data[message.start + _MESSAGE.size : message.end])
    body, size = fields[_FIELD_BODY], fields[_FIELD_SIZE]
    if not isinstance(body, bytes) or not isinstance(size, int) or size > _LARGEST_BODY:
        raise ValueError("not the fields of an Arrow message")
    if fields.get(_FIELD_COMPRESSION) == _LZ4:
        body = pa.decompress(body, size, "lz4_raw", asbytes=True)
    if entities is not None and not _names_any(body, entities):
        return "", None
    with pa.ipc.open_stream(pa.py_buffer(body)) as reader:
        entity = reader.schema.metadata[_ENTITY].decode()
        if entities is not None and entity not in entities:
            return entity, None
        table = reader.read_all()
    table.validate(full=True)
    return entity, table


def _names_any(body: bytes, entities: Collection[str]) -> bool:
    """Whether the schema, which comes first, may be that of one of these: it names its entity letter by letter.

    Opening a stream takes several times as long, and most messages are pictures.
    """
    if len(body) < _SCHEMA.size:
        raise ValueError("not an Arrow stream")
    _, length = _SCHEMA.unpack_from(body)
    schema = body[: _SCHEMA.size + length]
    return any(entity.encode() in schema for entity in entities)


def _fields(payload: bytes) -> dict[int, int | bytes]:
    """Fields of a protobuf message of varints and byte strings. Raises ValueError, IndexError."""
    fields: dict[int, int | bytes] = {}
    place = 0
    while place < len(payload):
        key, place = _varint(payload, place)
        if not key >> 3:
            raise ValueError("no field has the number 0")
        value, place = _varint(payload, place)
        if key & 7 == _VARINT:
            fields[key >> 3] = value
            continue
        if key & 7 != _BYTES or place + value > len(payload):
            raise ValueError("not a field of a message")
        fields[key >> 3] = payload[place : place + value]
        place += value
    return fields


def _varint(payload: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = payload[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
        shift += 7
