"""MF4 made byte by byte from the layout that ASAM publishes (MDF 4.1), and a quick reader of many of them.

Beside `python -m tests.replay.mf4_made`: the child of `replay.logs.mf4`, which forks for each log and so imports its
package only once.
"""

import os
import sys
from collections.abc import Sequence
from struct import Struct, pack
from typing import NamedTuple

BEGAN_NS = 1_672_531_200_000_000_000  # the first of January 2023, UTC
_UTC, _LOCAL = 2, 1  # flags of the head
_BUS_EVENT, _PLAIN = 2, 4  # flags of a group of records
_SOURCE_BUS, _CAN = 2, 2
_UNSIGNED, _BYTES = 0, 10
_FIXED, _MASTER, _VIRTUAL = 0, 2, 6


class Channel(NamedTuple):
    """Of a record: where its bits are. `step`: of a linear conversion. `constant`: no bits, the same in all records."""

    name: str
    byte: int = 0
    bits: int = 8
    bit: int = 0
    kind: int = _FIXED
    data: int = _UNSIGNED
    step: float | None = None
    constant: float | None = None


class Records(NamedTuple):
    """A group of records."""

    channels: Sequence[Channel]
    size: int
    records: bytes
    bus: int = _CAN


TIME = Channel("Timestamp", 0, 64, kind=_MASTER, step=1e-9)
_PACKED = Struct("<QLBB")  # time; id, IDE, BRS and EDL in 32 bits; length code, direction and channel; length
CANEDGE = (  # as the logger of that name packs them
    TIME,
    Channel("CAN_DataFrame.ID", 8, 29),
    Channel("CAN_DataFrame.IDE", 11, 1, 5),
    Channel("CAN_DataFrame.BRS", 11, 1, 6),
    Channel("CAN_DataFrame.EDL", 11, 1, 7),
    Channel("CAN_DataFrame.DLC", 12, 4),
    Channel("CAN_DataFrame.Dir", 12, 1, 4),
    Channel("CAN_DataFrame.BusChannel", 12, 2, 5),
    Channel("CAN_DataFrame.DataLength", 13, 7),
)


def canedge(width: int) -> Sequence[Channel]:
    """Channels of data frames with so many bytes."""
    return (*CANEDGE, Channel("CAN_DataFrame.DataBytes", 14, 8 * width, data=_BYTES))


def packed(  # a frame
    time_ns: int, identifier: int, data: bytes, code: int, *, flags: int = 0, sent: int = 0, channel: int = 1
) -> bytes:
    """A record of CANEDGE but for padding. `flags`: 1 IDE, 2 BRS, 4 EDL."""
    return _PACKED.pack(time_ns, identifier | flags << 29, code | sent << 4 | channel << 5, len(data)) + data


class _File:
    """Blocks behind the head, one after the other, each made when all that it leads to is."""

    def __init__(self) -> None:
        self.begin = 64 + 104
        self.bytes = bytearray()

    def block(self, kind: str, links: Sequence[int], content: bytes) -> int:
        """Its address."""
        length = 24 + 8 * len(links) + len(content)
        address = self.begin + len(self.bytes)
        self.bytes += pack("<4s4xQQ", f"##{kind}".encode(), length, len(links))
        self.bytes += pack(f"<{len(links)}Q", *links) + content + bytes(-length % 8)
        return address

    def text(self, words: str) -> int:
        return self.block("TX", (), words.encode() + b"\0")


def file(*groups: Records, local: bool = False, circle: bool = False, began_ns: int = BEGAN_NS) -> bytes:
    """A log. `circle`: the last group of data leads to itself."""
    made = _File()
    following = 0
    for number, group in enumerate(reversed(groups)):
        here = _group(made, group, following)
        if circle and not number:
            at = here - made.begin + 24
            made.bytes[at : at + 8] = pack("<Q", here)
        following = here
    head = pack(
        "<4s4xQQ6QQhhBBBxdd",
        b"##HD",
        104,
        6,
        following,
        0,
        0,
        0,
        0,
        0,
        began_ns,
        0,
        0,
        1 if local else 2,
        0,
        0,
        0.0,
        0.0,
    )
    return _identified(b"MDF     ", 0) + head + bytes(made.bytes)


def _identified(magic: bytes, unfinished: int) -> bytes:
    return pack("<8s8s8s4xH30xHH", magic, b"4.10    ", b"made", 410, unfinished, 0)


def unfinished(whole: bytes) -> bytes:
    """The same as its writer leaves it: neither counts of records nor the length of the last data are told."""
    made = bytearray(_identified(b"UnFinMF ", 1 | 4) + whole[64:])
    at = made.find(b"##CG")
    while at >= 0:
        made[at + 24 + 48 + 8 : at + 24 + 48 + 16] = bytes(8)
        at = made.find(b"##CG", at + 1)
    at = made.rfind(b"##DT")
    made[at + 8 : at + 16] = pack("<Q", 24)
    return bytes(made)


def _group(made: _File, group: Records, following: int) -> int:
    """Address of the group of data, with its records the last of all."""
    source = made.block("SI", (made.text("CAN"), made.text("CAN"), 0), pack("<BBB5x", _SOURCE_BUS, group.bus, 0))
    channel = 0
    for one in reversed(group.channels):
        channel = _channel(made, one, channel)
    count = len(group.records) // group.size
    counts = pack("<QQHH4xLL", 0, count, _BUS_EVENT | _PLAIN, ord("."), group.size, 0)
    records = made.block("CG", (0, channel, made.text("CAN"), source, 0, 0), counts)
    data = made.begin + len(made.bytes) + 64  # behind the block of the group itself
    here = made.block("DG", (following, records, data, 0), bytes(8))
    assert made.block("DT", (), group.records) == data
    return here


def _channel(made: _File, one: Channel, following: int) -> int:
    offset, step = (one.constant, 0.0) if one.constant is not None else (0.0, one.step)
    conversion = 0
    if step is not None:
        head = pack("<BBHHHdd", 1, 0, 0, 0, 2, 0.0, 0.0)
        conversion = made.block("CC", (0, 0, 0, 0), head + pack("<dd", offset, step))
    kind = _VIRTUAL if one.constant is not None else one.kind
    place = pack(
        "<BBBBLLLLBxHdddddd", kind, int(kind == _MASTER), one.data, one.bit, one.byte, one.bits, 0, 0, 0, 0, *[0.0] * 6
    )
    return made.block("CN", (following, 0, made.text(one.name), 0, conversion, 0, 0, 0), place)


def main() -> None:
    """For each line, `LOG OUT WRITABLE LIMIT...`: what the child would tell of a log goes to a file, its code to us."""
    from replay.logs import mf4, mf4_files  # noqa: PLC0415  # each child has them from here

    for line in sys.stdin:
        log, out, writable, *limits = line.split()
        child = os.fork()
        if not child:
            os.dup2(os.open(log, os.O_RDWR if writable == "1" else os.O_RDONLY), 0)
            os.dup2(os.open(out, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
            mf4_files.main(mf4.Limits(*map(int, limits)))
            os._exit(0)
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
