"""The one file that knows `asammdf`: reads the frames of an MF4 as a child of `replay.logs.mf4`, and writes one.

How this works
--------------
Names are those of ASAM's bus logging: a group of records for CAN_DataFrame, one for CAN_RemoteFrame, and so on, maybe
one for each bus and direction; their frames are merged by time. Times are counted since the beginning that the head
tells in ns. Most files have them as a float of seconds, which is exact to the ns for 48 days, others as whole steps,
which are kept as they are. `python -m replay.logs.mf4_files LIMIT...` reads the log that is its standard input.
"""

import fcntl
import heapq
import json
import os
import resource
import sys
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from struct import Struct
from typing import IO, Any, NamedTuple

import numpy as np
from asammdf import MDF, Signal, Source
from numpy.typing import NDArray

from drivers.contract import FD_LENGTHS, CanFrame
from replay.logs import mf4
from replay.logs.logged import MAX_LENGTH, SECOND_NS, Clock, Logged, date

DATA, REMOTE, ERROR, OVERLOAD = "CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame", "CAN_OverloadFrame"
_NO_FRAMES = {ERROR: "error frame", OVERLOAD: "overload frame"}
_BUSES = {Source.BUS_TYPE_LIN: "LIN", Source.BUS_TYPE_FLEXRAY: "FlexRay", Source.BUS_TYPE_ETHERNET: "Ethernet"}
_LOCAL_TIME = 1  # of the head's flags: its beginning is in a zone that it does not tell
_BUS_EVENT = 2  # of a group's flags
_LINEAR = 1  # kind of conversion
_VIRTUAL = {3, 6}  # kinds of channels: their raw value is the number of the record

_LATEST_S = 4e9  # since the beginning of a log; what comes later is damage
_FLAGS = {"IDE": mf4.EXTENDED, "EDL": mf4.FD, "BRS": mf4.SWITCH}
_COLUMNS = {"ID", "DLC", "DataLength", "DataBytes", "Dir", "BusChannel", *_FLAGS}

AT_ONCE = 1 << 15  # records that are read at once, of all groups together

ROW = np.dtype(
    [
        *(("time", "<i8"), ("id", "<u4"), ("flags", "u1"), ("sent", "u1"), ("length", "u1"), ("code", "u1")),
        *(("bus", "<u2"), ("data", "u1", 64)),
    ]
)
assert ROW.itemsize == mf4.ROW.size

_Array = NDArray[Any]


class _Group(NamedTuple):
    """Records of one kind. `channels`: their places by their names, without that of the kind."""

    number: int
    kind: str
    channels: Mapping[str, int]
    master: int | None
    records: int
    source: str


class _Buses:
    """Names of buses by number, in the order of their first frames."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def numbers(self, names: Sequence[str], of: _Array) -> _Array:
        """`of`: for each frame, which of the names."""
        for name in names:
            if name not in self.names:
                self.names.append(name)
        return np.array([self.names.index(name) for name in names], "<u2")[of]


class Log:
    """An MF4 that is open. Whatever is wrong with it is any exception of `asammdf`'s."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file: Any = MDF(file, process_bus_logging=False, use_display_names=False)  # type: ignore[arg-type, call-arg]
        self.style = f"MF4 {self._file.version}"
        self.left_out: dict[str, int] = {}
        header: Any = self._file.header
        self._begin_ns = int(header.abs_time)
        local = header.time_flags & _LOCAL_TIME
        self.clock = Clock.BEGINNING if not self._begin_ns else Clock.WALL if local else Clock.EPOCH
        self._groups = list(self._found())

    def _found(self) -> Iterator[_Group]:
        """The groups that hold frames of CAN; what the others hold is counted."""
        for number, group in enumerate(self._file.groups):
            records = int(group.channel_group.cycles_nr)
            names = [channel.name for channel in group.channels]
            kind = next((kind for kind in (DATA, REMOTE, *_NO_FRAMES) if f"{kind}.ID" in names or kind in names), None)
            if not records:
                continue
            if kind not in {DATA, REMOTE}:
                self._leave_out(_NO_FRAMES[kind] if kind else _other(group), records)
                continue
            source = group.channel_group.acq_source
            channels = {name.removeprefix(f"{kind}."): place for place, name in enumerate(names)}
            master = self._file.masters_db.get(number)
            yield _Group(number, kind, channels, master, records, source.name if source else "")

    def _leave_out(self, what: str, times: int = 1) -> None:
        self.left_out[what] = self.left_out.get(what, 0) + times

    def pieces(self) -> Iterator[tuple[list[str], bytes]]:
        """Rows for `mf4`, in the order of their times, some at a time, and the names of their buses."""
        at_once = max(AT_ONCE // max(len(self._groups), 1), 64)
        buses = _Buses()
        sources = [self._rows(group, at_once, buses) for group in self._groups]
        rows = heapq.merge(*sources, key=itemgetter(0)) if len(sources) > 1 else (row for one in sources for row in one)
        piece = bytearray()
        for _, row in rows:
            piece += row
            if len(piece) >= AT_ONCE * ROW.itemsize:
                yield buses.names, bytes(piece)
                piece.clear()
        yield buses.names, bytes(piece)

    def _rows(self, group: _Group, at_once: int, buses: _Buses) -> Iterator[tuple[int, bytes]]:
        """Each with the time up to which this group has come: frames that go backwards stay where they are."""
        latest = np.iinfo(np.int64).min
        for begin in range(0, group.records, at_once):
            try:
                rows = self._piece(group, begin, min(at_once, group.records - begin), buses)
            except Exception as error:  # whatever damage makes of it
                self._leave_out(f"records that cannot be read: {type(error).__name__}", group.records - begin)
                return
            times = np.maximum.accumulate(np.concatenate(([latest], rows["time"])))
            latest = times[-1]
            whole = rows.tobytes()
            size = ROW.itemsize
            yield from zip(
                times[1:].tolist(), (whole[at : at + size] for at in range(0, len(whole), size)), strict=True
            )
            if len(rows) < min(at_once, group.records - begin):
                self._leave_out("records that are missing", group.records - begin - len(rows))
                return

    def _piece(self, group: _Group, begin: int, count: int, buses: _Buses) -> _Array:
        """As many of them as there are of every column."""
        columns = {
            name: self._column(group.number, place, begin, count)
            for name, place in group.channels.items()
            if name in _COLUMNS
        }
        times = self._times(group, begin, count)
        length = min(len(one) for one in (times, *columns.values()))
        told = {name: column[:length] for name, column in columns.items()}
        told["ID"] = told["ID"].astype("<u4")
        rows = np.zeros(length, ROW)
        rows["time"] = times[:length]
        rows["id"] = told["ID"] & 0x1FFF_FFFF
        rows["flags"] = mf4.REMOTE if group.kind == REMOTE else 0
        bits = {"IDE": (told["ID"] > 0x7FF).astype("u1"), **told}
        for name, flag in _FLAGS.items():
            if name in bits:
                rows["flags"] |= np.where(bits[name] != 0, np.uint8(flag), np.uint8(0))
        rows["sent"] = _sent(told["Dir"]) if "Dir" in told else 2
        rows["bus"] = self._bus(group, told.get("BusChannel"), length, buses)
        if group.kind == DATA:
            _fill_data(rows, told)
        return rows

    def _column(self, group: int, place: int, begin: int, count: int) -> _Array:
        """As it is stored; what is the same in all records may only be in the conversion of a virtual channel."""
        raw = self._file.groups[group].channels[place].channel_type not in _VIRTUAL
        found = self._file.get(
            group=group, index=place, record_offset=begin, record_count=count, raw=raw, samples_only=True
        )
        column = np.asarray(found[0])
        return column if raw or column.dtype.kind in "SU" else column.astype("<i8")

    def _times(self, group: _Group, begin: int, count: int) -> _Array:
        """In ns; whole steps of the file stay whole."""
        if group.master is None:
            seconds = np.asarray(self._file.get_master(group.number, record_offset=begin, record_count=count))
            return _nanoseconds(seconds, 1.0, 0.0) + self._begin_ns
        raw = self._column(group.number, group.master, begin, count)
        conversion = self._file.groups[group.number].channels[group.master].conversion
        step, offset = 1.0, 0.0
        if conversion is not None:
            if conversion.conversion_type != _LINEAR:
                raise ValueError("times that are not linear")
            step, offset = conversion.a, conversion.b
        return _nanoseconds(raw, step, offset) + self._begin_ns

    def _bus(self, group: _Group, channel: _Array | None, length: int, buses: _Buses) -> _Array:
        if channel is None:
            return buses.numbers([group.source or "-"], np.zeros(length, int))
        found, of = np.unique(channel, return_inverse=True)
        return buses.numbers([str(one) for one in found.tolist()], of)


def _other(group: Any) -> str:  # noqa: ANN401  # of the package
    """What a group without frames of CAN holds, in words."""
    source = group.channel_group.acq_source
    if not group.channel_group.flags & _BUS_EVENT:
        return "record of measured signals"
    return f"frame of {_BUSES.get(source.bus_type if source else -1, 'another bus')}"


def _nanoseconds(raw: _Array, step: float, offset: float) -> _Array:
    """`raw` times `step` s and `offset` s: exactly where the step is whole ns and the times are whole numbers."""
    times = raw.astype(float) * step + offset
    if not np.all(np.abs(times) < _LATEST_S):
        raise ValueError("times that are none")
    step_ns = round(step * SECOND_NS)
    if not offset and step_ns and abs(step * SECOND_NS - step_ns) < 1e-6 and np.all(raw == np.rint(raw)):
        return raw.astype("<i8") * step_ns
    return np.rint(times * SECOND_NS).astype("<i8")


def _sent(direction: _Array) -> _Array:
    """By number (0: received), or in a letter or two."""
    if direction.dtype.kind in "SU":
        return np.asarray(np.char.lower(direction.astype("S2")) == b"tx")
    return np.minimum(direction, 2)


def _fill_data(rows: _Array, told: Mapping[str, _Array]) -> None:
    """Length code, length and data; a length that is more than there is becomes one that no frame has."""
    none = mf4.NO_CODE
    rows["code"] = np.minimum(told["DLC"], none) if "DLC" in told else none
    rows["length"] = np.minimum(told["DataLength"] if "DataLength" in told else _lengths(rows), none)
    data = told["DataBytes"]
    width = min(data.shape[1], rows["data"].shape[1])
    rows["data"][:, :width] = data[:, :width]
    rows["length"][rows["length"] > data.shape[1]] = none


def _lengths(rows: _Array) -> _Array:
    """Of the length codes, where a file tells no lengths."""
    codes = np.minimum(rows["code"], len(FD_LENGTHS) - 1)
    return np.asarray(np.where(rows["flags"] & mf4.FD, np.array(FD_LENGTHS)[codes], np.minimum(codes, MAX_LENGTH)))


# the child
_WORDS = 100  # characters of what an exception says


def main(limits: mf4.Limits) -> None:
    """Tell everything of the log that is the standard input on the standard output, and end with END or FAILED."""
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_DATA, limits.memory)
    _limit(resource.RLIMIT_FSIZE, limits.file)
    telling = _Telling()
    try:
        _tell_all(telling, limits.seconds)
    except Exception as error:  # whatever damage makes of it
        telling.say(mf4.FAILED, f"{type(error).__name__} {str(error)[:_WORDS]}".strip())


def _tell_all(telling: "_Telling", seconds: int) -> None:
    _more_time(seconds)
    with open(0, "rb+" if _may_write() else "rb", closefd=False) as file:  # it has no path
        log = Log(file)
        for buses, rows in log.pieces():
            telling.say(mf4.HEAD, {"style": log.style, "clock": log.clock.name, "buses": buses})
            telling.tell(mf4.ROWS, rows)
            _more_time(seconds)
    for what, times in log.left_out.items():
        telling.say(mf4.LEFT_OUT, [what, times, "the whole log"])
    telling.say(mf4.END, None)


def _may_write() -> bool:
    return fcntl.fcntl(0, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDWR


class _Telling:
    """What was the standard output; what `asammdf` prints of damage goes nowhere."""

    def __init__(self) -> None:
        self._out = os.fdopen(os.dup(1), "wb")
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)

    def say(self, kind: int, told: object) -> None:
        self.tell(kind, json.dumps(told).encode())

    def tell(self, kind: int, content: bytes) -> None:
        self._out.write(mf4.MESSAGE.pack(kind, len(content)) + content)
        self._out.flush()


def _limit(what: int, least: int) -> None:
    """Never more than what it is held to already."""
    _, hard = resource.getrlimit(what)
    limit = least if hard == resource.RLIM_INFINITY else min(least, hard)
    resource.setrlimit(what, (limit, hard))


def _more_time(seconds: int) -> None:
    used = resource.getrusage(resource.RUSAGE_SELF)
    _limit(resource.RLIMIT_CPU, round(used.ru_utime + used.ru_stime) + seconds)


# writing


class _Record:
    """Layout of the records of a kind: channels by their names, with their types as of Struct and as of Numpy."""

    def __init__(self, kind: str, fields: Mapping[str, tuple[str, str]]) -> None:
        self.pack = Struct("<" + "".join(code for code, _ in fields.values())).pack
        self.dtype = np.dtype([(f"{kind}.{name}", code) for name, (_, code) in fields.items()])


class _Waiting(NamedTuple):
    times: list[float]
    records: bytearray


_BYTE = ("B", "u1")
_OF_BOTH = {"BusChannel": _BYTE, "ID": ("L", "<u4"), "IDE": _BYTE, "Dir": _BYTE, "DLC": _BYTE, "DataLength": _BYTE}
_OF_DATA = {"EDL": _BYTE, "BRS": _BYTE, "DataBytes": ("64s", "(64,)u1")}
_RECORDS = {DATA: _Record(DATA, _OF_BOTH | _OF_DATA), REMOTE: _Record(REMOTE, _OF_BOTH)}  # a group each, in this order
_DEFLATE_TRANSPOSED = 2  # kind of compression


def _packed(channel: int, frame: CanFrame, *, sent: bool) -> bytes:
    length = len(frame.data)
    both = (channel, frame.id, frame.extended, sent, FD_LENGTHS.index(length), length)
    if frame.remote:
        return _RECORDS[REMOTE].pack(*both)
    return _RECORDS[DATA].pack(*both, frame.fd, frame.bit_rate_switch, frame.data)


class Writer:
    """MF4 with times as a float of seconds since a whole millisecond. `channels`: the number of each bus, from 1.

    Remote frames have a group of their own, so the order of one and a data frame of the same ns is not told.
    """

    def __init__(self, file: IO[bytes], channels: Mapping[str, int]) -> None:
        self.left_out: dict[str, int] = {}
        self._file = file
        self._channels = channels
        self._begin_ns: int | None = None
        self._log: Any = MDF(version="4.10")
        self._groups = {kind: _Waiting([], bytearray()) for kind in _RECORDS}
        for kind, record in _RECORDS.items():
            source = Source("", "", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
            self._log.append(
                Signal(np.array([], record.dtype), np.array([], float), name=kind, source=source), acq_name="CAN"
            )

    def add(self, logged: Logged) -> None:
        time_ns, frame, sent = logged
        assert time_ns is not None
        if self._begin_ns is None:
            self._begin_ns = time_ns // 1_000_000 * 1_000_000
        kind = REMOTE if frame.remote else DATA
        waiting = self._groups[kind]
        waiting.times.append((time_ns - self._begin_ns) / SECOND_NS)
        waiting.records.extend(_packed(self._channels[frame.bus], frame, sent=bool(sent)))
        if len(waiting.times) >= AT_ONCE:
            self._flush(kind)

    def _flush(self, kind: str) -> None:
        waiting = self._groups[kind]
        if waiting.times:
            records = np.frombuffer(bytes(waiting.records), _RECORDS[kind].dtype)
            self._log.extend(list(_RECORDS).index(kind), [(np.array(waiting.times), None), (records, None)])
        self._groups[kind] = _Waiting([], bytearray())

    def close(self) -> None:
        for kind in _RECORDS:
            self._flush(kind)
        self._log.header.start_time = date(self._begin_ns or 0)
        self._log.header.abs_time = self._begin_ns or 0
        self._log.save(self._file, compression=_DEFLATE_TRANSPOSED)
        self._log.close()
        self._file.flush()


if __name__ == "__main__":
    main(mf4.Limits(*map(int, sys.argv[1:])))
