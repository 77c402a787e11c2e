"""Which kind of log a file is, by what is in it and never by its name, and its frames."""

import gzip
import io
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple, TextIO

from replay.logs import asc, blf, candump, mf4, savvycan, trc
from replay.logs.logged import Account, LogError, Logged

LOOKED_AT = 1 << 16  # bytes of the beginning
MCAP = b"\x89MCAP0\r\n"
_GZIP = b"\x1f\x8b"
_FOREIGN = {  # what a log that is not read begins with
    b"RRF2": "a session, or a part of one: it needs no import",
    mf4.MAGIC: "MDF of before version 4, which has no frames of buses",
    b"SQLite format 3": "a bag of ROS 2 in SQLite, which is not read: convert it to MCAP, with `ros2 bag convert`",
    b"PK\x03\x04": "an archive: unpack it",
    b"***BUSMASTER": "a log of BusMaster, which is not read: convert it to ASC, with BusMaster itself",
    b"@ TEXT": "a log of CarBusAnalyzer, which is not read",
    b"#ROSBAG": "a bag of ROS 1, which is not read: convert it to MCAP",
}
_FOREIGN_TEXTS = {
    "Microchip Technology": "a log of Microchip's analyzer, which is not read: convert it, with SavvyCAN for example",
    " CXX ": "a log of CRTD, which is not read: convert it, with SavvyCAN for example",
}
KNOWN = "candump in each of its styles, ASC, BLF, MF4, TRC, SavvyCAN's CSV, or MCAP with can_msgs/msg/Frame"
_Frames = Iterator[Logged]


class _Text(NamedTuple):
    looks_like: Callable[[Iterable[str]], bool]
    frames: Callable[[Iterable[str], Account], _Frames]


_TEXTS = (
    _Text(trc.is_trc, trc.frames),
    _Text(savvycan.is_savvycan, savvycan.frames),
    _Text(asc.is_asc, asc.frames),
    _Text(candump.is_candump, candump.frames),  # the last: it has no head, and comments may be anything
)


@contextmanager
def opened(path: Path) -> Iterator[tuple[_Frames, Account]]:
    """The frames of a log, to be read once, and an account of the rest, filled meanwhile. Raises LogError."""
    account = Account()
    with ExitStack() as stack:
        try:
            file = stack.enter_context(_unpacked(stack.enter_context(path.open("rb"))))
            frames = _frames(path, file, stack, account)
        except OSError as error:
            raise _unreadable(path, error) from None
        yield _guarded(path, frames, account), account


def _guarded(path: Path, frames: _Frames, account: Account) -> _Frames:
    """What is packed may end or break anywhere; what was in front of it is read. Raises LogError."""
    try:
        yield from frames
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        account.leave_out("what follows does not unpack", f"line {account.lines + 1}", str(error))
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: OSError) -> LogError:
    return LogError(f"{path}: cannot be read: {error.strerror or error}")


def _unpacked(raw: BinaryIO) -> BinaryIO:
    packed = raw.read(len(_GZIP)) == _GZIP
    raw.seek(0)
    return gzip.GzipFile(fileobj=raw) if packed else raw  # type: ignore[return-value]


def _frames(path: Path, file: BinaryIO, stack: ExitStack, account: Account) -> _Frames:
    """Raises LogError, OSError."""
    begin = _begin(file)
    file.seek(0)
    if begin.startswith(blf.MAGIC):
        return blf.frames(file, account)
    if begin.startswith(MCAP):
        from replay.logs import mcap_frames  # noqa: PLC0415  # two packages that nothing else needs

        return mcap_frames.frames(file, account)
    if begin.startswith((mf4.MAGIC + mf4.VERSION, mf4.UNFINISHED + mf4.VERSION)):
        return mf4.frames(path, stack.enter_context(mf4.opened(file, begin, account)), account)
    for mark, words in _FOREIGN.items():
        if begin.startswith(mark):
            raise LogError(f"{path}: {words}")
    return _text_frames(path, begin, stack.enter_context(io.TextIOWrapper(file, encoding="latin-1")), account)


def _begin(file: BinaryIO) -> bytes:
    """As much of the beginning as there is and unpacks."""
    begin = b""
    with suppress(EOFError, zlib.error, gzip.BadGzipFile):
        while len(begin) < LOOKED_AT and (piece := file.read1(LOOKED_AT)):  # type: ignore[attr-defined]
            begin += piece
    return begin


def _text_frames(path: Path, begin: bytes, text: TextIO, account: Account) -> _Frames:
    """Every byte is a letter of Latin-1, which all of these are in as far as it matters. Raises LogError."""
    head = begin.decode("latin-1")
    lines = head.splitlines(keepends=True)
    for kind in _TEXTS:
        if kind.looks_like(lines):
            return kind.frames(text, account)
    for mark, words in _FOREIGN_TEXTS.items():
        if mark in head[:1000]:
            raise LogError(f"{path}: {words}")
    first = next(iter(lines), "")[:60].strip()
    raise LogError(f"{path}: no log that is known: line 1 is {first!r}, expected {KNOWN}")
