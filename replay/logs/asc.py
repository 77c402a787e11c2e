"""Vector's ASC: text with the time of each event since the beginning of a measurement, or since the event before.

How this works
--------------
Each trigger block is a measurement of its own: its times begin at zero again, and the date in front of it is that of
its zero. Dates have no zone and are taken as UTC. What is neither frame nor error frame (statistics, states of the
controller, markers) is counted as such.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TextIO

from drivers.contract import FD_LENGTHS, CanFrame
from replay.logs.logged import (
    MAX_LENGTH,
    Account,
    Clock,
    Logged,
    UnreadError,
    date,
    each_line,
    nanoseconds,
    seconds,
    sound,
    wall_ns,
)

HEAD = re.compile(r"(?:date\s|base\s+(?:hex|dec)\b|begin\s+triggerblock)", re.IGNORECASE)
_BASE = re.compile(r"base\s+(hex|dec)\s+timestamps\s+(absolute|relative)", re.IGNORECASE)
_DATE = re.compile(
    r"\S+\s+(\S+)\s+(\d{1,2})\s+(\d{1,2}):(\d\d):(\d\d)(?:\.(\d{1,9}))?\s*(am|pm)?\s+(\d{4})\s*$", re.IGNORECASE
)
_EVENT = re.compile(r"\s*(\d+(?:\.\d+)?)\s+(.*)$")
_MONTHS = {
    name: number
    for number, names in enumerate(
        ("jan", "feb", "mar mrz mär", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez"),
        start=1,
    )
    for name in names.split()
}
_BLOCK, _BLOCK_END = "begin triggerblock", "end triggerblock"
_START = "start of measurement"
_SAYS_NOTHING = ("//", "internal events", "no internal events", "date", "base", _BLOCK_END)
_MONTH_NAMES = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_DAY_NAMES = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")


def is_asc(lines: Iterable[str]) -> bool:
    """Whether one of these is of the head of such a log."""
    return any(HEAD.match(line) for line in lines)


def frames(text: Iterable[str], account: Account) -> Iterator[Logged]:
    """Every frame of these lines; what is none is in the account."""
    log = _Log(account)
    account.style = "ASC"
    yield from each_line(text, account, log.frame)


class _Log:
    """What the lines so far say of those that follow."""

    def __init__(self, account: Account) -> None:
        self._account = account
        self._base = 16
        self._relative = False
        self._zero_ns = self._last_ns = 0
        account.clock = Clock.BEGINNING

    def frame(self, line: str) -> Logged | None:
        """The frame of a line, None if it is of the head. Raises UnreadError."""
        match = _EVENT.match(line)
        if match is None:
            self._head(line)
            return None
        time_ns = nanoseconds(match[1])
        time_ns += self._last_ns if self._relative else self._zero_ns
        self._last_ns = time_ns
        words = match[2].split()
        if match[2].lower().startswith(_START):
            return None
        if "errorframe" in match[2].lower():
            raise UnreadError("error frame")
        if words and words[0].upper() == "CANFD":
            return self._fd(words[1:], time_ns)
        return self._classic(words, time_ns)

    def _head(self, line: str) -> None:
        words = line.strip().lower()
        base = _BASE.match(words)
        if base is not None:
            self._base = 16 if base[1] == "hex" else 10
            self._relative = base[2] == "relative"
        elif words.startswith(("date", _BLOCK)):
            self._begin(words.removeprefix(_BLOCK).removeprefix("date"), block=words.startswith(_BLOCK))
        elif words and not words.startswith(_SAYS_NOTHING):
            raise UnreadError("no line of ASC")

    def _begin(self, words: str, *, block: bool) -> None:
        """Where later times count from; as before where the date is none, and then raises UnreadError."""
        zero_ns = _date_ns(words.strip())
        if zero_ns is not None:
            self._account.clock = Clock.WALL
            self._zero_ns = self._last_ns = zero_ns
        elif block and self._last_ns > self._zero_ns:
            self._zero_ns = self._last_ns
        if zero_ns is None and words.strip():
            raise UnreadError("a date that is none")

    def _classic(self, words: Sequence[str], time_ns: int) -> Logged:
        """<channel> <id> Rx|Tx d|r <length code> <data>. Raises UnreadError."""
        if len(words) < 4 or not words[0].isdecimal() or words[2].lower() not in {"rx", "tx"}:
            raise UnreadError("event that is no frame")
        kind = words[3].lower()
        if kind not in {"d", "r"}:
            raise UnreadError("event that is no frame")
        identifier, extended = self._id(words[1])
        remote, data = kind == "r", b""
        if not remote:
            code = _number(words[4:5], 16)
            if code > 15:
                raise UnreadError("more or less data than a frame can have")
            data = self._data(words[5:], min(code, MAX_LENGTH))  # codes above 8 mean 8 bytes on a classic bus
        frame = CanFrame(words[0], identifier, data, extended, remote)
        return Logged(time_ns, sound(frame), words[2].lower() == "tx")

    def _fd(self, words: Sequence[str], time_ns: int) -> Logged:
        """<channel> Rx|Tx <id> [<name>] <brs> <esi> <length code> <length> <data>. Raises UnreadError."""
        if len(words) < 7 or not words[0].isdecimal() or words[1].lower() not in {"rx", "tx"}:
            raise UnreadError("event that is no frame")
        identifier, extended = self._id(words[2])
        rest = words[3:] if words[3] in {"0", "1"} else words[4:]
        if len(rest) < 4 or rest[0] not in {"0", "1"}:
            raise UnreadError("no CAN FD frame")
        code, length = _number(rest[2:3], 16), _number(rest[3:4], 10)
        if code > 15:
            raise UnreadError("more or less data than a frame can have")
        sent = words[1].lower() == "tx"
        if not length and code:  # nothing but a classic remote frame has a length code and no data
            return Logged(time_ns, sound(CanFrame(words[0], identifier, b"", extended, remote=True)), sent)
        if length != FD_LENGTHS[code]:
            raise UnreadError("more or less data than its length code says")
        data = self._data(rest[4:], length)
        frame = CanFrame(words[0], identifier, data, extended, fd=True, bit_rate_switch=rest[0] == "1")
        return Logged(time_ns, sound(frame), sent)

    def _id(self, word: str) -> tuple[int, bool]:
        extended = word[-1] in "xX"
        return _number([word[:-1] if extended else word], self._base), extended

    def _data(self, words: Sequence[str], length: int) -> bytes:
        found = [_number([word], self._base) for word in words[:length]]
        if len(found) != length or max(found, default=0) > 0xFF:
            raise UnreadError("fewer bytes of data than its length says")
        return bytes(found)


def _number(words: Sequence[str], base: int) -> int:
    try:
        number = int(words[0], base)
    except (IndexError, ValueError):
        raise UnreadError("a number that is none") from None
    if number < 0:
        raise UnreadError("a number that is none")
    return number


def _date_ns(words: str) -> int | None:
    match = _DATE.match(words)
    month = None if match is None else _MONTHS.get(match[1].lower()[:3])
    if match is None or month is None:
        return None
    hour = int(match[3])
    if match[7] is not None:
        hour = hour % 12 + (12 if match[7].lower() == "pm" else 0)
    try:
        zero_ns = wall_ns(int(match[8]), month, int(match[2]), hour, int(match[4]), int(match[5]))
    except ValueError:
        return None
    return zero_ns + nanoseconds(f"0.{match[6] or 0}")


class Writer:
    """ASC with absolute times of nine digits since a date in UTC. `channels`: the number of each bus, from 1."""

    def __init__(self, file: TextIO, channels: dict[str, int]) -> None:
        self.left_out: dict[str, int] = {}
        self._file = file
        self._channels = channels
        self._zero_ns: int | None = None

    def add(self, logged: Logged) -> None:
        time_ns, frame, sent = logged
        assert time_ns is not None
        if self._zero_ns is None:
            self._zero_ns = self._begin(time_ns)
        event = _fd_event if frame.fd else _classic_event
        words = event(frame, self._channels[frame.bus], "Tx" if sent else "Rx")
        self._file.write(f"{seconds(max(time_ns - self._zero_ns, 0)):>12} {words}\n")

    def close(self) -> None:
        if self._zero_ns is None:
            self._begin(0)
        self._file.write("End TriggerBlock\n")
        self._file.flush()

    def _begin(self, time_ns: int) -> int:
        """Zero is a whole millisecond: a date has no more digits."""
        zero_ns = time_ns // 1_000_000 * 1_000_000
        at = date(zero_ns)
        words = f"{_DAY_NAMES[at.weekday()]} {_MONTH_NAMES[at.month - 1]} {at.day:02d} {at:%H:%M:%S}"
        words += f".{at.microsecond // 1000:03d} {at.year}"
        self._file.write(f"date {words}\nbase hex  timestamps absolute\ninternal events logged\n")
        for name, number in self._channels.items():
            self._file.write(f"// channel {number}: {name}\n")
        self._file.write(f"Begin Triggerblock {words}\n{seconds(0):>12} Start of measurement\n")
        return zero_ns


def _classic_event(frame: CanFrame, channel: int, direction: str) -> str:
    identifier = f"{frame.id:X}{'x' if frame.extended else ''}"
    data = f"d {len(frame.data)} {frame.data.hex(' ').upper()}" if not frame.remote else "r 0"
    return f"{channel}  {identifier:<15} {direction:<4} {data}".rstrip()


def _fd_event(frame: CanFrame, channel: int, direction: str) -> str:
    identifier = f"{frame.id:X}{'x' if frame.extended else ''}"
    flags = 1 << 12 | (1 << 13 if frame.bit_rate_switch else 0)
    length = len(frame.data)
    return (
        f"CANFD {channel:>3} {direction:<4} {identifier:>8} {'':>33} {int(frame.bit_rate_switch)} 0 "
        f"{FD_LENGTHS.index(length):x} {length:>2} {frame.data.hex(' ').upper()} {0:>8} {0:>4} {flags:>8X} 0 0 0 0 0"
    )
