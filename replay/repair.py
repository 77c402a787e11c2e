"""A damaged segment cut back to what is whole: a walk over the messages of the file, each one decoded to be sure.

How this works
--------------
A Rerun file is a stream header followed by messages, each with its kind and length in front, and closed by an end
message whose tail holds the footer. There is no checksum per message. So a message is kept when it lies within the
file, is of a known kind and, if it holds Arrow data, unpacks and decodes completely. One that does not is left out;
the walk ends where the structure itself ends.
Source: measured with rerun-sdk 0.41.0 (layout of the framing and of the ArrowMsg fields).
"""

import mmap
from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import NamedTuple

import pyarrow as pa

STREAM_HEADER_BYTES = 12  # "RRF2", version 4 bytes, compression, serializer, 2 reserved
MAGIC = b"RRF2"
FOOTER_MARK = b"RRF2FOOT"
FOOTER_MARK_FROM_END = 12  # followed by a count of 4 bytes
_MESSAGE = Struct("<QQ")  # kind, payload length
_STORE_INFO, _ARROW, _BLUEPRINT = 1, 2, 3
_FIELD_COMPRESSION, _FIELD_SIZE, _FIELD_BODY = 2, 3, 5
_LZ4 = 2
_VARINT, _BYTES = 0, 2  # wire types of protobuf


class Cut(NamedTuple):
    """What a repair kept and left: messages kept, messages dropped, bytes behind the last whole message."""

    kept: int
    dropped: int
    bytes_left: int


def has_footer(path: Path) -> bool:
    """Whether the file was closed in order."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size < STREAM_HEADER_BYTES + FOOTER_MARK_FROM_END:
            return False
        file.seek(size - FOOTER_MARK_FROM_END)
        return file.read(len(FOOTER_MARK)) == FOOTER_MARK


def repair(source: Path, target: Path) -> Cut:
    """Write the whole messages of `source` to `target`. Raises ValueError if it is no Rerun file, OSError."""
    kept = dropped = 0
    with source.open("rb") as file, target.open("wb") as out:
        if file.read(len(MAGIC)) != MAGIC or source.stat().st_size < STREAM_HEADER_BYTES:
            message = f"{source}: not a Rerun file"
            raise ValueError(message)
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            end = STREAM_HEADER_BYTES
            out.write(data[:end])
            for kind, start, end in _messages(data):
                if kind == _ARROW and not _decodes(data[start + _MESSAGE.size : end]):
                    dropped += 1
                    continue
                out.write(data[start:end])
                kept += 1
            return Cut(kept, dropped, len(data) - end)


def _messages(data: mmap.mmap) -> Iterator[tuple[int, int, int]]:
    """Kind, start and end of every message that lies within the file, up to the end message or the damage."""
    place = STREAM_HEADER_BYTES
    while place + _MESSAGE.size <= len(data):
        kind, length = _MESSAGE.unpack_from(data, place)
        end = place + _MESSAGE.size + length
        if kind not in {_STORE_INFO, _ARROW, _BLUEPRINT} or end > len(data):
            return
        yield kind, place, end
        place = end


def _decodes(payload: bytes) -> bool:
    try:
        fields = _fields(payload)
        body = fields[_FIELD_BODY]
        if fields.get(_FIELD_COMPRESSION) == _LZ4:
            body = pa.decompress(body, fields[_FIELD_SIZE], "lz4_raw")
        with pa.ipc.open_stream(pa.py_buffer(body)) as reader:
            reader.read_all().validate()
    except (KeyError, IndexError, ValueError, TypeError, OSError, pa.ArrowException, MemoryError):
        return False
    return True


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
            message = "not a field of a message"
            raise ValueError(message)
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
