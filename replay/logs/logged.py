"""What every log of CAN frames comes down to: frames with their times, and an account of what was left out."""

from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime, timedelta
from enum import Enum
from typing import NamedTuple, Protocol

from drivers.contract import FD_LENGTHS, CanFrame

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
SECOND_NS = 1_000_000_000
EPOCH_BEGINS_NS = 100_000_000 * SECOND_NS  # March 1973: a stamp below counts from some other moment
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
ERROR_FLAG = 0x2000_0000  # of linux/can.h: the frame is the controller's own word on an error, and no frame of the bus
MAX_LENGTH = 8  # bytes of a classic frame
TEXT_SHOWN = 80
UNENDED = "a last line without an end, which may be cut"


class LogError(Exception):
    """A log that cannot be read or written at all; the text says which file and why."""


class UnreadError(ValueError):
    """Something in a log that is no frame; the words say why."""


class Logged(NamedTuple):
    """One frame of a log. `time_ns`: by the log's clock, None where it tells none. `frame.bus`: the log's channel.

    `sent`: by whoever wrote the log; None where it does not say.
    """

    time_ns: int | None
    frame: CanFrame
    sent: bool | None = None


class Clock(Enum):
    """What the times of a log count from."""

    EPOCH = "since 1970, UTC"
    WALL = "wall time without a zone, taken as UTC"
    BEGINNING = "since the beginning of the log; when that was it does not tell"
    NONE = "none: it tells no times"


class LeftOut(NamedTuple):
    """Something of a log that became no frame: how often, where first, and what stood there."""

    times: int
    place: str
    text: str


class Account:
    """What was found in a log beside its frames. `clock` and `style` hold once the first frame has come."""

    def __init__(self) -> None:
        self.style = ""
        self.clock = Clock.NONE
        self.lines = 0  # or objects of a binary log
        self.left_out: dict[str, LeftOut] = {}

    def leave_out(self, what: str, place: str, text: str = "", *, times: int = 1) -> None:
        """Count something that is no frame, and keep the first of its kind to show."""
        before, *first = self.left_out.get(what) or LeftOut(0, place, text.strip()[:TEXT_SHOWN])
        self.left_out[what] = LeftOut(before + times, *first)


class LogWriter(Protocol):
    """Writes frames to a log. Raises OSError."""

    left_out: dict[str, int]  # what this kind of log cannot hold

    def add(self, logged: Logged) -> None:
        """One frame. Its time is never None."""
        ...

    def close(self) -> None:
        """The end of the log."""
        ...


def each_line(text: Iterable[str], account: Account, frame: Callable[[str], Logged | None]) -> Iterator[Logged]:
    """The frames of the lines of a text of which only whole lines can be believed."""
    for number, line in enumerate(text, start=1):
        account.lines = number
        try:
            logged = frame(line)
        except UnreadError as error:
            account.leave_out(str(error), f"line {number}", line)
            continue
        if logged is not None and line.endswith("\n"):
            yield logged
        elif logged is not None:
            account.leave_out(UNENDED, f"line {number}", line)


def sound(frame: CanFrame) -> CanFrame:
    """The same frame. Raises UnreadError where no bus can have carried it."""
    if not 0 <= frame.id <= (MAX_EXTENDED_ID if frame.extended else MAX_STANDARD_ID):
        raise UnreadError("an id that is none")
    if len(frame.data) not in FD_LENGTHS or (len(frame.data) > MAX_LENGTH and not frame.fd):
        raise UnreadError("more or less data than a frame can have")
    if frame.fd and frame.remote:
        raise UnreadError("remote frame of CAN FD")
    return frame


def nanoseconds(seconds: str) -> int:
    """A decimal number of seconds, exactly; digits beyond the ninth are cut off. Raises ValueError."""
    whole, _, fraction = seconds.partition(".")
    return int(whole) * SECOND_NS + int((fraction[:9] or "0").ljust(9, "0"))


def seconds(time_ns: int, digits: int = 9) -> str:
    """The same back, cut off behind so many digits."""
    whole, rest = divmod(time_ns, SECOND_NS)
    return f"{whole}.{rest:09d}"[: len(str(whole)) + 1 + digits]


def wall_ns(*fields: int) -> int:
    """ns since 1970 of year, month, day, hour, minute, second in UTC. Raises ValueError, also before 1970."""
    year, month, day, hour, minute, second = fields
    since = datetime(year, month, day, hour, minute, second, tzinfo=UTC) - EPOCH
    if since < timedelta(0):
        raise ValueError("a date before 1970")
    return since // timedelta(seconds=1) * SECOND_NS


def date(time_ns: int) -> datetime:
    """The date in UTC, cut off to the microsecond. Raises OverflowError."""
    return EPOCH + timedelta(microseconds=time_ns // 1000)
