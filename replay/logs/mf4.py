"""ASAM MDF 4 with CAN bus logging (MF4), read by `asammdf` in a process of its own that is held to limits.

How this works
--------------
Links in a damaged MF4 may run in circles and sizes may be anything, and `asammdf` follows them. So it runs in a child
(`mf4_files`) with bounded memory, time between two answers and files, which writes rows of one size to a pipe; what it
did not live to tell is left out in words. A log that is packed, or that its writer did not finish (CANedge leaves all
of its logs so), is first unpacked into a file without a name, which the child may finish; the log itself is only read.
"""

import gzip
import json
import os
import signal
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from struct import Struct
from typing import IO, NamedTuple

from drivers.contract import FD_LENGTHS, CanFrame
from replay.logs.logged import MAX_LENGTH, Account, Clock, LogError, Logged, UnreadError, sound

MAGIC, UNFINISHED = b"MDF     ", b"UnFinMF "
VERSION = b"4"  # begins behind the magic; MDF 3 and before have no frames of buses
EXTRA = "MF4 needs the package `asammdf`: pip install 'drivegate[mf4]'"

MESSAGE = Struct("<BL")  # from the child: kind, bytes that follow
HEAD, ROWS, LEFT_OUT, FAILED, END = range(5)  # kinds; all but ROWS hold JSON
ROW = Struct("<qLBBBBH64s")  # time in ns, id, flags, whether it was sent, length, length code, number of the bus, data
EXTENDED, REMOTE, FD, SWITCH = 1, 2, 4, 8  # flags
SENT = (False, True, None)
NO_CODE = 0xFF

_CHILD = "replay.logs.mf4_files"
_PIECE = 1 << 20  # bytes


class Limits(NamedTuple):
    """What a child may use: bytes of its own, of a file in which it puts a log in order, s between two answers."""

    memory: int
    file: int
    seconds: int


LIMITS = Limits(memory=2 << 30, file=8 << 30, seconds=60)


class _Head(NamedTuple):
    """What the child says in front of rows. `buses`: names by number."""

    style: str
    clock: str
    buses: list[str]


def is_installed() -> bool:
    """Whether the package is there that reads and writes them."""
    return find_spec("asammdf") is not None


@contextmanager
def opened(file: IO[bytes], begin: bytes, account: Account) -> Iterator["Child"]:
    """A child that reads this log, and that ends with the block. Raises LogError, OSError."""
    if not is_installed():
        raise LogError(EXTRA)
    with tempfile.TemporaryDirectory(prefix="drivegate-mf4-") as folder, tempfile.TemporaryFile(dir=folder) as copy:
        packed = isinstance(file, gzip.GzipFile)
        if packed or begin.startswith(UNFINISHED):
            _copy(file, copy, account)
        with Child(copy if copy.tell() else file, Path(folder)) as child:
            yield child


def _copy(file: IO[bytes], copy: IO[bytes], account: Account) -> None:
    """As much as there is and unpacks."""
    try:
        while piece := file.read1(_PIECE):  # type: ignore[attr-defined]
            copy.write(piece)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        account.leave_out("what follows does not unpack", f"byte {copy.tell()}", str(error))
    copy.flush()


class Child:
    """The process that reads, as a context: it does not outlive it."""

    def __init__(self, source: IO[bytes], folder: Path) -> None:
        environment = os.environ | {"TMPDIR": str(folder), "OPENBLAS_NUM_THREADS": "1", "NUMEXPR_MAX_THREADS": "1"}
        os.lseek(source.fileno(), 0, os.SEEK_SET)
        self._process = subprocess.Popen(
            [sys.executable, "-m", _CHILD, *map(str, LIMITS)],
            stdin=source,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def messages(self) -> Iterator[tuple[int, bytes]]:
        """Kind and content of all that it says, the last of kind FAILED or END, whatever becomes of it."""
        assert self._process.stdout is not None
        read = self._process.stdout.read
        while len(head := read(MESSAGE.size)) == MESSAGE.size:
            kind, length = MESSAGE.unpack(head)
            content = read(length)
            if len(content) < length:
                break
            yield kind, content
            if kind in {FAILED, END}:
                return
        yield FAILED, json.dumps(_why(self._process.wait())).encode()


def _why(code: int) -> str:
    if code == -signal.SIGXCPU:
        return "its reader came to no end"
    return f"its reader ended with {code}"


def frames(path: Path, child: Child, account: Account) -> Iterator[Logged]:
    """Every frame of this log; what is none is in the account. Raises LogError where nothing of it can be read."""
    head: _Head | None = None
    for kind, content in child.messages():
        if kind == ROWS:
            assert head is not None
            yield from _rows(content, head.buses, account)
            continue
        told = json.loads(content)
        if kind == HEAD:
            head = _Head(**told)
            account.style, account.clock = head.style, Clock[head.clock]
        elif kind == LEFT_OUT:
            what, times, place = told
            account.leave_out(what, place, times=times)
        elif kind == FAILED and head is None:
            raise LogError(f"{path}: an MF4 that is cut or damaged: {told}")
        elif kind == FAILED:
            account.leave_out(f"what follows is cut or damaged: {told}", f"after frame {account.lines}")


def _rows(content: bytes, buses: list[str], account: Account) -> Iterator[Logged]:
    for row in ROW.iter_unpack(content):
        account.lines += 1
        try:
            yield _logged(row, buses)
        except UnreadError as error:
            account.leave_out(str(error), f"frame {account.lines}")


def _logged(row: tuple[int, int, int, int, int, int, int, bytes], buses: list[str]) -> Logged:
    """Raises UnreadError."""
    time_ns, identifier, flags, sent, length, code, bus, data = row
    remote, fd = bool(flags & REMOTE), bool(flags & FD)
    if time_ns < 0:
        raise UnreadError("a time that is none")
    if not remote and (length > len(data) or (code not in {NO_CODE, length} and length != _length(code, fd=fd))):
        raise UnreadError("more or less data than its length code says")
    content = b"" if remote else data[:length]
    frame = CanFrame(
        buses[bus], identifier, content, bool(flags & EXTENDED), remote, None, fd, fd and bool(flags & SWITCH)
    )
    return Logged(time_ns, sound(frame), SENT[sent])


def _length(code: int, *, fd: bool) -> int | None:
    if code >= len(FD_LENGTHS):
        return None
    return FD_LENGTHS[code] if fd else min(code, MAX_LENGTH)
