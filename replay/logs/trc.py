"""PEAK's TRC, 1.0 to 2.1: text with the time of each message since a date, in ms.

How this works
--------------
The columns are those of the version, or those that the file names (2.x). Dates have no zone and are taken as UTC.
Source: PEAK CAN TRC file format, as its files describe themselves.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation

from drivers.contract import FD_LENGTHS, CanFrame
from replay.logs.logged import MAX_LENGTH, SECOND_NS, Account, Clock, Logged, UnreadError, each_line, sound, wall_ns

HEAD = re.compile(r";\$FILEVERSION=\d|;#{40,}\s*$")
_VERSION = re.compile(r";\$FILEVERSION=(\d\.\d)")
_START = re.compile(r";\$STARTTIME=(\d+(?:\.\d+)?)\s*$")
_COLUMNS = re.compile(r";\$COLUMNS=([A-Za-z,]+)\s*$")
_COMMENT_START = re.compile(
    r";\s+Start time:\s+(\d{1,2})\.(\d{1,2})\.(\d{4}) (\d\d):(\d\d):(\d\d)(?:\.(\d{3}))?(?:\.(\d{1,3}))?"
)
_LAYOUTS = {"1.0": "NOIlD", "1.1": "NOTIlD", "1.2": "NOBTIlD", "1.3": "NOBTIRlD"}  # columns by the letters of 2.x
_DAYS_TO_1970 = 25569  # since the 30th of December 1899
_DAY_NS = 86_400 * SECOND_NS
_MILLISECOND_NS = 1_000_000
_NO_FRAMES = {
    "ST": "status of the hardware",
    "EC": "change of error counters",
    "ER": "error frame",
    "EV": "event",
    "WARNG": "warning",
    "ERROR": "error frame",
}
_FD_TYPES = {"FD": False, "FB": True, "FE": False, "BI": True, "FI": False}  # and whether the bit rate is switched
_CLASSIC_TYPES = {"DT", "RR", "RX", "TX"}
_NO_ID = 0xFFFF_FFFF  # in 1.0, of a warning
_EXTENDED_DIGITS = 8
_ALL = "1"  # the channel of a file that tells none


def is_trc(lines: Iterable[str]) -> bool:
    """Whether one of these is of the head of such a log."""
    return any(HEAD.match(line) for line in lines)


def frames(text: Iterable[str], account: Account) -> Iterator[Logged]:
    """Every frame of these lines; what is none is in the account."""
    account.style, account.clock = "TRC 1.0", Clock.BEGINNING
    log = _Log(account)
    yield from each_line(text, account, log.frame)


class _Log:
    """What the head says of the lines that follow."""

    def __init__(self, account: Account) -> None:
        self._account = account
        self._layout = _LAYOUTS["1.0"]
        self._zero_ns = 0

    def frame(self, line: str) -> Logged | None:
        """The frame of a line, None if it is of the head. Raises UnreadError."""
        if line.startswith(";"):
            self._head(line)
            return None
        words = line.split()
        if not words:
            return None
        cells = self._cells(words)
        kind = cells.get("T", "").upper()
        if kind in _NO_FRAMES:
            raise UnreadError(_NO_FRAMES[kind])
        if kind not in _FD_TYPES and kind not in _CLASSIC_TYPES and "T" in cells:
            raise UnreadError("message of a type that is none")
        return self._made(cells, kind)

    def _cells(self, words: Sequence[str]) -> Mapping[str, str]:
        """By the letter of the column; the bytes of data, which come last, in one."""
        single = self._layout.removesuffix("D")
        if len(words) < len(single):
            raise UnreadError("no line of TRC")
        return dict(zip(single, words, strict=False)) | {"D": " ".join(words[len(single) :])}

    def _made(self, cells: Mapping[str, str], kind: str) -> Logged:
        try:
            identifier, length = int(cells["I"], 16), int(cells.get("l", cells.get("L", "")))
            time_ns = self._zero_ns + nanoseconds_of_ms(cells["O"])
        except (KeyError, ValueError):
            raise UnreadError("no line of TRC") from None
        if identifier == _NO_ID:
            raise UnreadError("warning")
        fd = kind in _FD_TYPES
        remote = kind == "RR" or cells["D"].startswith("RTR")
        if fd and "l" not in cells:
            length = FD_LENGTHS[length] if 0 <= length < len(FD_LENGTHS) else -1
        data = b"" if remote else _data(cells["D"], length if fd else min(length, MAX_LENGTH))
        extended = len(cells["I"]) == _EXTENDED_DIGITS
        frame = CanFrame(cells.get("B", _ALL), identifier, data, extended, remote, None, fd, _FD_TYPES.get(kind, False))
        direction = cells.get("d", cells.get("T", "")).lower()
        return Logged(time_ns, sound(frame), {"tx": True, "rx": False}.get(direction))

    def _head(self, line: str) -> None:
        if match := _VERSION.match(line):
            self._account.style = f"TRC {match[1]}"
            self._layout = _LAYOUTS.get(match[1], "NOTBIdRLD")
        elif match := _COLUMNS.match(line):
            self._layout = match[1].replace(",", "")
        elif match := _START.match(line):
            self._begin(_days_ns(match[1]))
        elif (match := _COMMENT_START.match(line)) and self._account.clock is Clock.BEGINNING:
            day, month, year, hour, minute, second = map(int, match.groups()[:6])
            try:
                zero_ns = wall_ns(year, month, day, hour, minute, second)
            except ValueError:
                raise UnreadError("a date that is none") from None
            self._begin(zero_ns + int(match[7] or 0) * _MILLISECOND_NS + int((match[8] or "0").ljust(3, "0")) * 1000)

    def _begin(self, zero_ns: int) -> None:
        self._zero_ns = zero_ns
        self._account.clock = Clock.WALL


def nanoseconds_of_ms(milliseconds: str) -> int:
    """A decimal number of ms, exactly. Raises ValueError."""
    whole, _, fraction = milliseconds.partition(".")
    number = int(whole) * _MILLISECOND_NS + int((fraction[:6] or "0").ljust(6, "0"))
    if number < 0 or whole.startswith("-"):
        raise ValueError("a time that is none")
    return number


def _days_ns(days: str) -> int:
    try:
        return int((Decimal(days) - _DAYS_TO_1970) * _DAY_NS)
    except InvalidOperation:
        raise UnreadError("a date that is none") from None


def _data(words: str, length: int) -> bytes:
    found = words.split()[: max(length, 0)]
    if len(found) != length or not all(len(word) == 2 for word in found):
        raise UnreadError("fewer bytes of data than its length says")
    try:
        return bytes.fromhex("".join(found))
    except ValueError:
        raise UnreadError("data that is not hexadecimal") from None
