"""Segments as files, read without trust: every message is checked before anything is made of it.

How this works
--------------
A Rerun file is a stream header followed by messages, each with its kind and length in front, and closed by an end
message whose tail marks the footer. Messages carry no checksum, and Rerun's own reader ends the whole process on some
damaged ones (measured with 0.41: 4 of 6 files with flipped bits). So this walks over the messages itself: one is taken
when it lies within the file, is of a known kind and, if it holds Arrow data, unpacks, decodes and validates
completely. One that does not is left out; the walk ends where the structure itself ends. The tail behind the end
message says where in the file that message began, so that a file from which bytes were taken is known as such even
if what is left has all the structure it should have.
Source: measured with rerun-sdk 0.41.0 (layout of the framing and of the ArrowMsg fields).
"""

import mmap
import zlib
from collections.abc import Collection, Iterator
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
_FIELD_COMPRESSION, _FIELD_SIZE, _FIELD_BODY = 2, 3, 5
_LZ4 = 2
_LARGEST_BODY = 1 << 30  # a batch unpacked; more is a damaged length
_VARINT, _BYTES = 0, 2  # wire types of protobuf
_ENTITY = b"rerun:entity_path"
_DAMAGED = (KeyError, IndexError, TypeError, ValueError, OSError, MemoryError, pa.ArrowException)


class Cut(NamedTuple):
    """What a repair kept and left: messages kept, messages dropped, bytes behind the last whole message."""

    kept: int
    dropped: int
    bytes_left: int


class Found(NamedTuple):
    """Record batches by entity path, the place in the file of the last message of each, and what is wrong with it."""

    batches: dict[str, list[pa.RecordBatch]]
    places: dict[str, int]
    problem: str | None


class _Message(NamedTuple):
    kind: int
    start: int
    end: int


def read(path: Path, entities: Collection[str], *, first_only: bool = False) -> Found:
    """The whole messages of these entities. Raises ValueError if it is no Rerun file, OSError."""
    batches: dict[str, list[pa.RecordBatch]] = {}
    places: dict[str, int] = {}
    intact, end = True, None
    with path.open("rb") as file, _mapped(file.fileno(), path) as data:
        for message in _messages(data):
            end = message if message.kind == _END else None
            if message.kind != _ARROW:
                continue
            try:
                entity, table = _decoded(data, message, entities)
            except _DAMAGED:
                intact = False
                continue
            if table is None:
                continue
            batches.setdefault(entity, []).extend(table.to_batches())
            places[entity] = message.start
            if first_only:
                break
        return Found(batches, places, _problem(data, end, intact=intact))


def checksum(path: Path, length: int) -> int:
    """CRC-32 of so many bytes from the start of the file. Raises ValueError if it is no Rerun file, OSError."""
    with path.open("rb") as file, _mapped(file.fileno(), path) as data, memoryview(data) as view, view[:length] as part:
        return zlib.crc32(part)


def repair(source: Path, target: Path) -> Cut:
    """Write the whole messages of `source` to `target`. Raises ValueError if it is no Rerun file, OSError."""
    kept = dropped = 0
    end = STREAM_HEADER_BYTES
    with source.open("rb") as file, _mapped(file.fileno(), source) as data, target.open("wb") as out:
        out.write(data[:end])
        for message in _messages(data):
            if message.kind == _END:
                break
            end = message.end
            if message.kind == _ARROW and not _decodes(data, message):
                dropped += 1
                continue
            out.write(data[message.start : message.end])
            kept += 1
        return Cut(kept, dropped, len(data) - end)


def _problem(data: mmap.mmap, end: _Message | None, *, intact: bool) -> str | None:
    """What is wrong with a file, from its end message and whether all others could be read."""
    tail = data[-FOOTER_TAIL.size :]
    place, length, _, mark, _ = FOOTER_TAIL.unpack(tail) if len(tail) == FOOTER_TAIL.size else (0, 0, 0, b"", 0)
    if end is None and mark != FOOTER_MARK:
        return "it was not closed: its end may be missing"
    start = None if end is None else end.start + _MESSAGE.size
    if (
        end is None
        or mark != FOOTER_MARK
        or (place, place + length, len(data)) != (start, end.end, end.end + len(tail))
    ):
        return "it is not as it was written: bytes are missing, added or changed"
    return None if intact else "it is damaged"


def _mapped(descriptor: int, path: Path) -> mmap.mmap:
    if path.stat().st_size >= STREAM_HEADER_BYTES:
        data = mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
        if data[: len(MAGIC)] == MAGIC:
            return data
        data.close()
    raise ValueError("not a Rerun file")


def _messages(data: mmap.mmap) -> Iterator[_Message]:
    """Every message that lies within the file, up to and with the end message, or up to the damage."""
    place = STREAM_HEADER_BYTES
    while place + _MESSAGE.size <= len(data):
        kind, length = _MESSAGE.unpack_from(data, place)
        end = place + _MESSAGE.size + length
        if kind not in {_END, _STORE_INFO, _ARROW, _BLUEPRINT} or end > len(data):
            return
        yield _Message(kind, place, end)
        if kind == _END:
            return
        place = end


def _decodes(data: mmap.mmap, message: _Message) -> bool:
    try:
        _decoded(data, message, None)
    except _DAMAGED:
        return False
    return True


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
