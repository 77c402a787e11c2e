"""MCAP of ROS 2: `can_msgs/msg/Frame` in CDR, and `ros2_socketcan_msgs/msg/FdFrame` for what is longer.

How this works
--------------
A bus has a topic for each direction, `/<bus>/from_can_bus` and `/<bus>/to_can_bus`, as those of ros2_socketcan are
named, with `_fd` behind for CAN FD. The time of the log and the stamp in the message are the same, in ns.
"""

import struct
from collections.abc import Iterator
from types import SimpleNamespace
from typing import IO, Any

from mcap.exceptions import McapError
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as RosWriter

from drivers.contract import CanFrame
from replay.logs.logged import (
    EPOCH_BEGINS_NS,
    MAX_LENGTH,
    SECOND_NS,
    Account,
    Clock,
    LogError,
    Logged,
    UnreadError,
    sound,
)

MAGIC = b"\x89MCAP0\r\n"
CLASSIC, FD = "can_msgs/msg/Frame", "ros2_socketcan_msgs/msg/FdFrame"
_HEADER = (
    "=" * 80
    + """
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
    + "=" * 80
    + """
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
)
_DEFINITIONS = {
    CLASSIC: "std_msgs/Header header\nuint32 id\nbool is_rtr\nbool is_extended\nbool is_error\nuint8 dlc\n"
    "uint8[8] data\n" + _HEADER,
    FD: "std_msgs/Header header\nuint32 id\nbool is_extended\nbool is_error\nuint8 len\nuint8[<=64] data\n" + _HEADER,
}
_DIRECTIONS = {"from_can_bus": False, "to_can_bus": True}  # and whether such frames were sent
_LARGEST = 1 << 28  # bytes of a record; more is a damaged length
_MAX_SECONDS = 2**31 - 1  # of ROS's time
# What damaged files raise in the readers of the two packages.
_DAMAGED = (
    McapError,
    struct.error,
    ValueError,
    LookupError,
    AttributeError,
    TypeError,
    OverflowError,
    EOFError,
    MemoryError,
)


def frames(file: IO[bytes], account: Account) -> Iterator[Logged]:
    """Every frame of this log; what is none is in the account."""
    account.style, account.clock = "MCAP", Clock.EPOCH
    schemas: dict[int, Schema] = {}
    topics: dict[int, Channel] = {}
    decoders = DecoderFactory()
    for record in _records(file, account):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                topics[record.id] = record
            case Message():
                account.lines += 1
                try:
                    yield _logged(record, topics, schemas, decoders, account)
                except UnreadError as error:
                    account.leave_out(str(error), f"message {account.lines}")


def _records(file: IO[bytes], account: Account) -> Iterator[Any]:
    """The records up to the end, or to where the file is cut or damaged."""
    records = iter(StreamReader(file, record_size_limit=_LARGEST, validate_crcs=True).records)
    while True:
        try:
            record = next(records, None)
        except Exception as error:  # the decompressors of chunks have errors of their own
            account.leave_out(
                f"what follows is cut or damaged: {type(error).__name__}", f"after message {account.lines}"
            )
            return
        if record is None:
            return
        yield record


def _logged(
    message: Message, topics: dict[int, Channel], schemas: dict[int, Schema], decoders: DecoderFactory, account: Account
) -> Logged:
    """Raises UnreadError."""
    topic = topics.get(message.channel_id)
    schema = None if topic is None else schemas.get(topic.schema_id)
    if topic is None or schema is None:
        raise UnreadError("a message of a topic that is not told")
    if schema.name not in _DEFINITIONS:
        raise UnreadError(f"a message of {schema.name}")
    try:
        decode = decoders.decoder_for(topic.message_encoding, schema)
        told: Any = None if decode is None else decode(message.data)
        frame, sent = _frame(told, topic.topic, fd=schema.name == FD)
        time_ns = told.header.stamp.sec * SECOND_NS + told.header.stamp.nanosec or message.log_time
    except UnreadError:
        raise
    except _DAMAGED:
        raise UnreadError(f"a message that is no {schema.name}") from None
    if time_ns < EPOCH_BEGINS_NS:
        account.clock = Clock.BEGINNING
    return Logged(time_ns, frame, sent)


def _frame(told: Any, topic: str, *, fd: bool) -> tuple[CanFrame, bool | None]:  # noqa: ANN401  # fields by the schema
    """Raises UnreadError, and what the fields of a message that is none raise."""
    if told is None:
        raise UnreadError("a message that is not in CDR")
    if told.is_error:
        raise UnreadError("error frame")
    *spaces, last = topic.strip("/").split("/")
    sent = _DIRECTIONS.get(last.removesuffix("_fd"))
    bus = topic if sent is None or not spaces else "/".join(spaces)
    length = told.len if fd else told.dlc
    remote = not fd and told.is_rtr
    data = b"" if remote else bytes(told.data[:length])
    if not remote and len(data) != length:
        raise UnreadError("fewer bytes of data than its length says")
    return sound(CanFrame(bus, told.id, data, told.is_extended, remote, None, fd)), sent


class Writer:
    """MCAP, compressed. What cannot be told: whether the bit rate of a CAN FD frame was switched."""

    def __init__(self, file: IO[bytes]) -> None:
        self.left_out: dict[str, int] = {}
        self._writer = RosWriter(file, compression=CompressionType.ZSTD)
        self._schemas = {name: self._writer.register_msgdef(name, text) for name, text in _DEFINITIONS.items()}

    def add(self, logged: Logged) -> None:
        time_ns, frame, sent = logged
        assert time_ns is not None
        whole, rest = divmod(time_ns, SECOND_NS)
        if whole > _MAX_SECONDS:
            raise LogError("a time after 2038, which the messages of ROS 2 do not have")
        name = FD if frame.fd else CLASSIC
        topic = f"/{frame.bus}/{'to' if sent else 'from'}_can_bus{'_fd' if frame.fd else ''}"
        header = SimpleNamespace(stamp=SimpleNamespace(sec=whole, nanosec=rest), frame_id=frame.bus)
        message = SimpleNamespace(header=header, id=frame.id, is_extended=frame.extended, is_error=False)
        if frame.fd:
            message.len, message.data = len(frame.data), list(frame.data)
        else:
            message.is_rtr, message.dlc = frame.remote, len(frame.data)
            message.data = list(frame.data.ljust(MAX_LENGTH, b"\0"))
        self._writer.write_message(topic, self._schemas[name], message, log_time=time_ns, publish_time=time_ns)

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]  # of the package
