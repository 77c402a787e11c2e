"""candump's text, in each of its styles: plain, with times (-ta, -tA, -td, -tz), flags (-x, -e, -c, -a), and -L.

How this works
--------------
A line of -L begins with its time in parentheses and has a # between id and data; every other style has a length in
brackets. The flag of an error frame is looked at before anything else: with it cut off, what the controller says of
an error would be a frame with an id like 4. Whether times of other styles count from the first line (-tz) or from the
line before (-td) is told by their course: since the beginning they hardly ever fall, and differences do all the time.
Source: can-utils, candump.c and lib.c.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice, pairwise
from typing import TextIO

from drivers.contract import CanFrame
from replay.logs.logged import (
    EPOCH_BEGINS_NS,
    ERROR_FLAG,
    UNENDED,
    Account,
    Clock,
    Logged,
    UnreadError,
    nanoseconds,
    seconds,
    sound,
    wall_ns,
)

LOOKED_AT = 2000  # lines by which the course of the times is judged
FALLING_SHARE = 8  # one of so many times that does not grow: they are differences
EXTENDED_DIGITS = 8
MASK = 0x1FFF_FFFF
BIT_RATE_SWITCH = 1  # of the flags behind the second # of CAN FD
NO_CHANNEL = "-"  # of a line that names none

COMPACT = re.compile(r"\s*\(([0-9.]+)\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(\S*)(?:\s+([TR]))?\s*$")
WIDE = re.compile(
    r"\s*(?:\(([^()]*)\)\s*)?(?:([^\s()\[\]]+)\s+)??(?:(TX|RX)(?:\s+([B-])\s+[E-])?\s+)?"
    r"([0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})\s+\[(\d{1,2})\](.*)$"
)
_DATA = re.compile(r"(?:[0-9A-Fa-f]{2}\.?)*$")
_REMOTE = re.compile(r"R[0-9A-Fa-f]?(?:_[0-9A-Fa-f])?$")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_WALL = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)(?:\.(\d{1,9}))?$")
_COMMENT = ("#", "//", ";")


def is_candump(lines: Iterable[str]) -> bool:
    """Whether any of these is a line of candump."""
    return any(COMPACT.match(line) or WIDE.match(_COLOUR.sub("", line)) for line in lines)


def frames(text: Iterable[str], account: Account) -> Iterator[Logged]:
    """Every frame of these lines; what is none is in the account."""
    lines = enumerate(text, start=1)
    head = list(islice(lines, LOOKED_AT))
    stamps = _Stamps(line for _, line in head)
    account.style, account.clock = stamps.style, stamps.clock
    for number, line in chain(head, lines):
        account.lines = number
        try:
            logged = _compact(line) if COMPACT.match(line) else _wide(line, stamps)
        except UnreadError as error:
            account.leave_out(str(error), f"line {number}", line)
            continue
        if logged is not None:
            yield logged


def _compact(line: str) -> Logged:
    """A line of -L. Raises UnreadError."""
    match = COMPACT.match(line)
    assert match is not None
    stamp, channel, digits, data, direction = match.groups()
    if not line.endswith("\n"):
        raise UnreadError(UNENDED)
    identifier = int(digits, 16)
    if identifier & ERROR_FLAG and len(digits) == EXTENDED_DIGITS:
        raise UnreadError("error frame")
    fd, switch = False, False
    if data.startswith("##"):
        raise UnreadError("CAN XL frame")
    if data.startswith("#"):
        if len(data) < 2 or data[1] not in "0123456789abcdefABCDEF":
            raise UnreadError("CAN FD frame without flags")
        fd, switch, data = True, bool(int(data[1], 16) & BIT_RATE_SWITCH), data[2:]
    remote = not fd and _REMOTE.match(data) is not None
    payload = b"" if remote else _payload(data)
    frame = CanFrame(channel, identifier & MASK, payload, len(digits) == EXTENDED_DIGITS, remote, None, fd, switch)
    return Logged(_number(stamp), sound(frame), None if direction is None else direction == "T")


def _payload(data: str) -> bytes:
    data = data.partition("_")[0]  # behind it the raw length code of a classic frame that is longer than eight bytes
    if not _DATA.match(data):
        raise UnreadError("data that is no whole bytes")
    return bytes.fromhex(data.replace(".", ""))


def _wide(line: str, stamps: "_Stamps") -> Logged | None:
    """A line of any other style; None for one that says nothing of frames. Raises UnreadError."""
    match = WIDE.match(_COLOUR.sub("", line) if "\x1b" in line else line)
    if match is None:
        _pass_over(line)
        return None
    stamp, channel, direction, switch, digits, length, rest = match.groups()
    time_ns = stamps.time_ns(stamp)
    identifier = int(digits, 16)
    extended = len(digits) == EXTENDED_DIGITS
    if extended and identifier & ERROR_FLAG:
        raise UnreadError("error frame")
    remote = rest.split()[:2] == ["remote", "request"]
    data = b"" if remote else _words(rest, int(length))
    fd = len(length) > 1  # candump writes the length of a CAN FD frame with two digits
    frame = CanFrame(channel or NO_CHANNEL, identifier & MASK, data, extended, remote, None, fd, switch == "B")
    return Logged(time_ns, sound(frame), None if direction is None else direction == "TX")


def _words(rest: str, length: int) -> bytes:
    """So many bytes in hexadecimal, maybe with text behind them. Raises UnreadError."""
    words = rest.split(None, length)[:length]
    if "`" in rest.partition("'")[0]:  # -S: the last byte first
        words = rest.split(None, 1)[0].split("`")[::-1]
    if len(words) != length or not all(len(word) == 2 for word in words):
        raise UnreadError("fewer bytes of data than its length says")
    try:
        return bytes.fromhex("".join(words))
    except ValueError:
        raise UnreadError("data that is not hexadecimal") from None


def _pass_over(line: str) -> None:
    """Comments, empty lines and what candump says of an error frame below it are nothing. Raises UnreadError."""
    if line.startswith("\t") or not line.strip() or line.lstrip().startswith(_COMMENT):
        return
    raise UnreadError("no line of candump")


def _number(stamp: str) -> int:
    try:
        return nanoseconds(stamp)
    except ValueError:
        raise UnreadError("a time that is none") from None


def _wall_ns(stamp: str) -> int | None:
    match = _WALL.match(stamp)
    if match is None:
        return None
    try:
        return wall_ns(*map(int, match.groups()[:6])) + nanoseconds(f"0.{match[7] or 0}")
    except ValueError:
        return None


class _Stamps:
    """Which kind of times a log has, by its first lines, and the time of each line."""

    def __init__(self, lines: Iterable[str]) -> None:
        found: list[str] = []
        compact = False
        for line in lines:
            match = COMPACT.match(line)
            compact = compact or match is not None
            match = match or WIDE.match(_COLOUR.sub("", line))
            if match is not None and match[1] is not None:
                found.append(match[1])
        numbers = [time for time in map(_whole, found) if time is not None]
        self._walls = any(_wall_ns(stamp) is not None for stamp in found)
        self._differences = not compact and not self._walls and _are_differences(numbers)
        self._sum_ns = 0
        self.clock = self._clock(numbers)
        self.style = f"candump {'-L' if compact else self._option(numbers)}".strip()

    def _clock(self, numbers: Sequence[int]) -> Clock:
        if self._walls:
            return Clock.WALL
        if not numbers:
            return Clock.NONE
        return Clock.EPOCH if min(numbers) >= EPOCH_BEGINS_NS else Clock.BEGINNING

    def _option(self, numbers: Sequence[int]) -> str:
        if self._walls:
            return "-tA"
        if not numbers:
            return ""
        if self._differences:
            return "-td"
        return "-ta" if self.clock is Clock.EPOCH else "-tz"

    def time_ns(self, stamp: str | None) -> int | None:
        """Raises UnreadError."""
        if stamp is None:
            return None
        if self._walls:
            time_ns = _wall_ns(stamp)
            if time_ns is None:
                raise UnreadError("a time that is none")
            return time_ns
        time_ns = _number(stamp)
        if not self._differences:
            return time_ns
        self._sum_ns += time_ns
        return self._sum_ns


def _whole(stamp: str) -> int | None:
    try:
        return nanoseconds(stamp)
    except ValueError:
        return None


def _are_differences(numbers: Sequence[int]) -> bool:
    steps = len(numbers) - 1
    if steps < 1 or numbers[0] >= EPOCH_BEGINS_NS:
        return False
    falling = sum(after <= before for before, after in pairwise(numbers))
    return falling * FALLING_SHARE >= steps


class Writer:
    """candump -L -x, which can-utils and python-can read: times to the microsecond, cut off."""

    def __init__(self, file: TextIO) -> None:
        self.left_out: dict[str, int] = {}
        self._file = file

    def add(self, logged: Logged) -> None:
        time_ns, frame, sent = logged
        assert time_ns is not None
        direction = "" if sent is None else " T" if sent else " R"
        self._file.write(f"({seconds(time_ns, 6)}) {_raw(frame)}{direction}\n")

    def close(self) -> None:
        self._file.flush()


def _raw(frame: CanFrame) -> str:
    data = "R" if frame.remote else frame.data.hex().upper()
    flags = f"#{BIT_RATE_SWITCH if frame.bit_rate_switch else 0}" if frame.fd else ""
    return f"{frame.bus} {frame.id:0{8 if frame.extended else 3}X}#{flags}{data}"
