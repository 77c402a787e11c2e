"""Vector's BLF: objects in compressed containers, with times in ns or steps of 10 us since a whole millisecond.

How this works
--------------
Containers are unpacked one after the other into one stream, in which each object begins with a mark, its size and its
kind; an object may go on in the next container. What lies between two objects is passed over up to the next mark, and
counted if it is more than padding. Kinds that hold no frame are counted by their number.
Source: Toby Lorenz, Vector BLF (the layout as python-can documents it); what both read is held together in the tests.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from struct import Struct
from typing import BinaryIO, NamedTuple

from drivers.contract import FD_LENGTHS, CanFrame
from replay.logs.logged import MAX_LENGTH, Account, Clock, Logged, UnreadError, date, sound, wall_ns

MAGIC, OBJECT = b"LOGG", b"LOBJ"
_FILE = Struct("<4sLBBBBBBBBQQLL8H8H")
_FILE_BYTES = 144
_BASE = Struct("<4sHHLL")  # mark, length of the header, its version, length of the object, kind
_TIMES = {1: Struct("<LHHQ"), 2: Struct("<LBxHQ8x")}  # by version of the header: flags, two of no use here, time
_CONTAINER = Struct("<H6xL4x")  # compression, length unpacked
_CLASSIC = Struct("<HBBL8s")  # channel, flags, length, id, data
_FD = Struct("<HBBLLBBB5x64s")  # channel, flags, length code, id, two of no use, FD flags, bytes of data, data
_FD_64 = Struct(
    "<BBBBLLLLLLLHBBL"
)  # channel, length code, bytes of data, ., id, ., flags, ..., sent, place of the rest

_KIND_CLASSIC, _KIND_CONTAINER, _KIND_CLASSIC_2, _KIND_FD, _KIND_FD_64 = 1, 10, 86, 100, 101
_KIND_BUFFER_END = 115  # of the writer of the file
_NO_FRAMES = {  # what else such a log may hold of a bus
    2: "error frame",
    3: "overload frame",
    73: "error frame",
    104: "error frame",
    4: "statistics of a bus",
    31: "state of a controller",
    65: "application trigger",
    92: "event comment",
    96: "marker",
}
_PLAIN, _ZLIB = 0, 2
_TEN_MICROSECONDS = 1  # of the flags of an object; otherwise its time is in ns
_EXTENDED = 0x8000_0000
_MASK = 0x1FFF_FFFF
_SENT, _REMOTE = 0x01, 0x80
_FD_FRAME, _FD_SWITCH = 0x1, 0x2
_FD_64_REMOTE, _FD_64_FRAME, _FD_64_SWITCH = 0x0010, 0x1000, 0x2000
_LARGEST = 1 << 26  # bytes of an object or a container unpacked; more is a damaged length
_PADDING = 8


def frames(file: BinaryIO, account: Account) -> Iterator[Logged]:
    """Every frame of this log; what is none is in the account."""
    account.style = "BLF"
    head = file.read(_FILE.size)
    if len(head) < _FILE.size:
        account.leave_out("a log that ends within its head", "byte 0")
        return
    fields = _FILE.unpack(head)
    file.read(max(min(fields[1], _LARGEST) - _FILE.size, 0))
    begin_ns = _system_time_ns(fields[14:22])
    account.clock = Clock.BEGINNING if begin_ns is None else Clock.WALL
    reader = _Objects(file, account, begin_ns or 0)
    yield from reader.frames()
    if fields[12] > account.lines:
        account.leave_out(f"objects that are missing: {fields[12]} by its head, {account.lines} are there", "the end")


class _Objects:
    def __init__(self, file: BinaryIO, account: Account, begin_ns: int) -> None:
        self._file = file
        self._account = account
        self._begin_ns = begin_ns
        self._stream = b""

    def frames(self) -> Iterator[Logged]:
        for piece in self._pieces():
            self._stream += piece
            yield from self._unpacked()
        if len(self._stream) >= _PADDING:
            self._account.leave_out("an object that is cut", f"the last {len(self._stream)} bytes unpacked")

    def _pieces(self) -> Iterator[bytes]:
        """What the containers hold; an object outside of one as it is."""
        place = self._file.tell()
        while head := self._file.read(_BASE.size):
            if len(head) < _BASE.size or head[:4] != OBJECT:
                self._account.leave_out(
                    "bytes where a container should begin; what follows is not read", f"byte {place}"
                )
                return
            _, _, _, length, kind = _BASE.unpack(head)
            body = self._file.read(min(max(length - _BASE.size, 0), _LARGEST))
            padding = self._file.read(length % 4)
            if len(body) < length - _BASE.size:
                self._account.leave_out("a container that is cut", f"byte {place}")
            yield self._container(body, place) if kind == _KIND_CONTAINER else head + body + padding
            place += length + length % 4

    def _container(self, body: bytes, place: int) -> bytes:
        """As much of it as can be unpacked."""
        if len(body) < _CONTAINER.size:
            return b""
        method, length = _CONTAINER.unpack_from(body)
        if method == _PLAIN:
            return body[_CONTAINER.size :]
        if method != _ZLIB:
            self._account.leave_out(f"a container compressed by method {method}", f"byte {place}")
            return b""
        unpacker = zlib.decompressobj()
        found = b""
        try:
            for begin in range(_CONTAINER.size, len(body), 4096):  # in pieces: what is in front of the damage is whole
                found += unpacker.decompress(body[begin : begin + 4096], _LARGEST)
                if len(found) > _LARGEST:
                    self._account.leave_out("a container with more in it than is read", f"byte {place}")
                    return found
        except zlib.error:
            self._account.leave_out("a container that does not unpack", f"byte {place}")
            return found
        if len(found) < length:
            self._account.leave_out("a container with less in it than it says", f"byte {place}")
        return found

    def _unpacked(self) -> Iterator[Logged]:
        """The objects that are whole; what is left waits for the next container."""
        stream, place = self._stream, 0
        while True:
            begin = stream.find(OBJECT, place)
            if begin < 0:
                place = max(place, len(stream) - len(OBJECT) + 1) if len(stream) - place > _PADDING else place
                break
            if begin - place >= _PADDING:
                self._account.leave_out("bytes between two objects", f"object {self._account.lines + 1}")
            place = begin
            if len(stream) - place < _BASE.size:
                break
            _, header, version, length, kind = _BASE.unpack_from(stream, place)
            if not _BASE.size <= length <= _LARGEST:
                self._account.leave_out("an object of a length that is none", f"object {self._account.lines + 1}")
                place += len(OBJECT)
                continue
            if place + length > len(stream):
                break
            self._account.lines += 1
            if kind == _KIND_BUFFER_END:
                place += length
                continue
            try:
                yield self._frame(stream[place : place + length], header, version, kind)
            except (UnreadError, struct.error) as error:
                words = str(error) if isinstance(error, UnreadError) else f"object of kind {kind} that is too short"
                self._account.leave_out(words, f"object {self._account.lines}")
            place += length
        self._stream = stream[place:]

    def _frame(self, found: bytes, header: int, version: int, kind: int) -> Logged:
        """Raises UnreadError, struct.error."""
        parse = _PARSERS.get(kind)
        if parse is None:
            raise UnreadError(_NO_FRAMES.get(kind, f"object of kind {kind}"))
        times = _TIMES.get(version)
        if times is None:
            raise UnreadError(f"object with a header of version {version}")
        flags, _, _, time = times.unpack_from(found, _BASE.size)
        time_ns = time * (10_000 if flags == _TEN_MICROSECONDS else 1)
        frame, sent = parse(found, _BASE.size + times.size, header)
        return Logged(self._begin_ns + time_ns, sound(frame), sent)


class _Kind(NamedTuple):
    remote: bool
    fd: bool
    switch: bool


_Parsed = tuple[CanFrame, bool]


def _classic(found: bytes, place: int, _: int) -> _Parsed:
    channel, flags, length, identifier, data = _CLASSIC.unpack_from(found, place)
    if length > 15:
        raise UnreadError("more or less data than a frame can have")
    remote = bool(flags & _REMOTE)
    data = b"" if remote else data[: min(length, MAX_LENGTH)]
    return _made(channel, identifier, data, _Kind(remote, fd=False, switch=False)), bool(flags & _SENT)


def _fd(found: bytes, place: int, _: int) -> _Parsed:
    channel, flags, code, identifier, _, _, fd_flags, valid, data = _FD.unpack_from(found, place)
    kind = _Kind(bool(flags & _REMOTE), bool(fd_flags & _FD_FRAME), bool(fd_flags & _FD_SWITCH))
    return _of_code(channel, identifier, code, data[:valid], kind), bool(flags & _SENT)


def _fd_64(found: bytes, place: int, _: int) -> _Parsed:
    fields = _FD_64.unpack_from(found, place)
    channel, code, valid, _, identifier, _, flags = fields[:7]
    sent, rest = fields[12:14]
    place += _FD_64.size
    data = found[place : min(place + valid, rest or len(found))].ljust(valid, b"\0")  # as Vector's own reader has it
    kind = _Kind(bool(flags & _FD_64_REMOTE), bool(flags & _FD_64_FRAME), bool(flags & _FD_64_SWITCH))
    return _of_code(channel, identifier, code, data, kind), bool(sent)


def _of_code(channel: int, identifier: int, code: int, data: bytes, kind: _Kind) -> CanFrame:
    if code > 15 or (not kind.remote and len(data) != (FD_LENGTHS[code] if kind.fd else min(code, MAX_LENGTH))):
        raise UnreadError("more or less data than its length code says")
    return _made(channel, identifier, b"" if kind.remote else data, kind)


def _made(channel: int, identifier: int, data: bytes, kind: _Kind) -> CanFrame:
    extended = bool(identifier & _EXTENDED)
    switch = kind.fd and kind.switch
    return CanFrame(str(channel), identifier & _MASK, data, extended, kind.remote, None, kind.fd, switch)


_PARSERS: dict[int, Callable[[bytes, int, int], _Parsed]] = {
    _KIND_CLASSIC: _classic,
    _KIND_CLASSIC_2: _classic,
    _KIND_FD: _fd,
    _KIND_FD_64: _fd_64,
}


def _system_time_ns(fields: tuple[int, ...]) -> int | None:
    """Of Windows' SYSTEMTIME; None where it is no date."""
    year, month, _, day, hour, minute, second, milliseconds = fields
    try:
        return wall_ns(year, month, day, hour, minute, second) + milliseconds * 1_000_000
    except ValueError:
        return None


def _system_time(time_ns: int) -> tuple[int, ...]:
    at = date(time_ns)
    return at.year, at.month, at.isoweekday() % 7, at.day, at.hour, at.minute, at.second, at.microsecond // 1000


class Writer:
    """BLF with times in ns. `channels`: the number of each bus, from 1."""

    def __init__(self, file: BinaryIO, channels: dict[str, int]) -> None:
        self.left_out: dict[str, int] = {}
        self._file = file
        self._channels = channels
        self._begin_ns: int | None = None
        self._last_ns = 0
        self._objects = 0
        self._unpacked = _FILE_BYTES
        self._waiting = bytearray()
        file.write(bytes(_FILE_BYTES))

    def add(self, logged: Logged) -> None:
        time_ns, frame, sent = logged
        assert time_ns is not None
        if self._begin_ns is None:
            self._begin_ns = time_ns // 1_000_000 * 1_000_000
        self._last_ns = time_ns
        kind, body = self._body(frame, sent=bool(sent))
        header = _BASE.size + _TIMES[1].size
        self._waiting += _BASE.pack(OBJECT, header, 1, header + len(body), kind)
        self._waiting += _TIMES[1].pack(2, 0, 0, max(time_ns - self._begin_ns, 0)) + body + bytes(len(body) % 4)
        self._objects += 1
        if len(self._waiting) >= _CONTAINER_BYTES:
            self._flush()

    def _body(self, frame: CanFrame, *, sent: bool) -> tuple[int, bytes]:
        channel = self._channels[frame.bus]
        identifier = frame.id | (_EXTENDED if frame.extended else 0)
        flags = (_SENT if sent else 0) | (_REMOTE if frame.remote else 0)
        length = len(frame.data)
        if not frame.fd:
            return _KIND_CLASSIC, _CLASSIC.pack(channel, flags, length, identifier, frame.data)
        fd_flags = _FD_FRAME | (_FD_SWITCH if frame.bit_rate_switch else 0)
        code = FD_LENGTHS.index(length)
        return _KIND_FD, _FD.pack(channel, flags, code, identifier, 0, 0, fd_flags, length, frame.data)

    def _flush(self) -> None:
        if not self._waiting:
            return
        packed = zlib.compress(self._waiting)
        length = _BASE.size + _CONTAINER.size + len(packed)
        self._file.write(_BASE.pack(OBJECT, _BASE.size, 1, length, _KIND_CONTAINER))
        self._file.write(_CONTAINER.pack(_ZLIB, len(self._waiting)) + packed + bytes(length % 4))
        self._unpacked += _BASE.size + _CONTAINER.size + len(self._waiting)
        self._waiting.clear()

    def close(self) -> None:
        self._flush()
        size = self._file.tell()
        begin_ns = self._begin_ns or 0
        times = _system_time(begin_ns) + _system_time(max(self._last_ns, begin_ns))
        counts = (size, self._unpacked, self._objects, 0)
        self._file.seek(0)
        self._file.write(_FILE.pack(MAGIC, _FILE_BYTES, 5, 0, 0, 0, 2, 6, 8, 1, *counts, *times))
        self._file.seek(size)
        self._file.flush()


_CONTAINER_BYTES = 128 * 1024
