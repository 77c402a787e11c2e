"""The latched emergency stop outlives the process and a power cut: a file, and a thread that keeps it.

How this works
--------------
`EstopFile` is the disk: written beside, synced, renamed, the folder synced. It is set unless it is certainly not there:
an unreadable or malformed file, or one that was being written, counts as set. `EstopLatch` is what the loop sees: it
says what is wanted, its thread does it, and a disk that hangs holds up that thread alone. What may be told of a stop
that is not on disk yet is decided in `gateway.edges.estop_gate`.
"""

import json
import logging
import os
import tempfile
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Condition, Thread
from time import CLOCK_REALTIME, clock_gettime
from typing import NamedTuple, Protocol

logger = logging.getLogger(__name__)

RETRY_S = 1.0
CLOSE_S = 1.0  # what a stop that has just been set gets to reach the disk when the process ends
LONGEST = 4096  # bytes of a file that can be ours


class Kept(NamedTuple):
    """A stop found at start: when it was set, or why it is assumed. `sound`: the file need not be written again."""

    note: str
    sound: bool


class Store(Protocol):
    """Where the latch is kept. Every method may take long; all but `read` raise OSError."""

    def prepare(self) -> None: ...

    def read(self) -> Kept | None: ...

    def set(self, *, wall: str, reason: str) -> None: ...

    def clear(self) -> None: ...


class EstopFile:
    """`<robot>.estop` in the state directory, mode 0640: {"set_wall": ISO time, "reason": text}."""

    def __init__(self, directory: Path, robot: str) -> None:
        self._directory = directory
        self._path = directory / f"{robot}.estop"
        self._beside = directory / f"{robot}.estop.new"

    def prepare(self) -> None:
        """Make the directory and see whether it can be written."""
        _make(self._directory)
        with tempfile.TemporaryFile(dir=self._directory) as probe:
            probe.write(b"x")
            probe.flush()
            os.fsync(probe.fileno())

    def read(self) -> Kept | None:
        """None only if no stop is set, for certain. Never raises."""
        try:
            return _parse(_text(self._path), self._path)
        except FileNotFoundError:
            pass
        except OSError as error:
            return Kept(f"assumed to be set, because {self._path} cannot be read: {error.strerror}", sound=False)
        try:
            os.lstat(self._beside)
        except FileNotFoundError:
            return None
        except OSError as error:
            return Kept(f"assumed to be set, because {self._beside} cannot be seen: {error.strerror}", sound=False)
        return Kept(f"assumed to be set, because {self._beside} was being written", sound=False)

    def set(self, *, wall: str, reason: str) -> None:
        """On the disk when it returns."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(self._beside, flags, 0o640), "wb") as file:
            os.fchmod(file.fileno(), 0o640)
            file.write(json.dumps({"set_wall": wall, "reason": reason}).encode())
            file.flush()
            os.fsync(file.fileno())
        self._beside.replace(self._path)
        _sync(self._directory)

    def clear(self) -> None:
        """Gone from the disk when it returns."""
        for path in (self._beside, self._path):
            path.unlink(missing_ok=True)
        _sync(self._directory)


class EstopLatch:
    """Never waits but in `close`. `kept`: what was found at start."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self.kept = store.read()
        self._wanted = self.kept is not None
        # None: not known, because something was tried and has not succeeded, or is not sound.
        self._on_disk: bool | None = None if self.kept is not None and not self.kept.sound else self._wanted
        self._problem: str | None = None
        self._closing = False
        self._changed = Condition()
        if self.kept is not None:
            logger.warning("the emergency stop is kept: %s", self.kept.note)
        try:
            store.prepare()
        except OSError as error:
            self._problem = f"an emergency stop will not outlive a restart: {_words(error)}"
            logger.warning("%s", self._problem)
        self._thread = Thread(target=self._run, name="estop latch", daemon=True)
        self._thread.start()

    @property
    def on_disk(self) -> bool:
        """Whether the stop is wanted and is on the disk."""
        return self._wanted and self._on_disk is True

    @property
    def problem(self) -> str | None:
        """Why what is wanted is not so, once it was tried."""
        return self._problem

    def want(self, *, stopped: bool) -> None:
        """Whether the emergency stop is to be set; called every cycle."""
        if stopped is self._wanted:
            return
        with self._changed:
            self._wanted, self._problem = stopped, None
            self._changed.notify()

    def health(self) -> dict[str, object]:
        """For the robot's status. One that is no longer wanted is on disk until it is certainly gone."""
        on_disk = self.on_disk if self._wanted else self._on_disk is not False
        return {"on_disk": on_disk, "problem": self._problem}

    def close(self, timeout: float = CLOSE_S) -> None:
        """End the thread; a change that is under way gets this long."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(timeout)

    def _run(self) -> None:
        while (wanted := self._next()) is not None:
            problem = self._try(stopped=wanted)
            with self._changed:
                if problem is None:
                    self._on_disk = wanted
                if wanted is self._wanted:
                    self._tell(problem)
                if problem is not None:
                    self._changed.wait_for(partial(self._hurry, wanted), RETRY_S)

    def _next(self) -> bool | None:
        """Waits until something is to be done; what the disk is to say, None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._closing or self._on_disk is not self._wanted)
            if self._on_disk is self._wanted or (self._closing and self._problem is not None):
                return None
            self._on_disk = None
            return self._wanted

    def _hurry(self, tried: bool) -> bool:
        """Whether the next attempt need not wait."""
        return self._closing or self._wanted is not tried

    def _tell(self, problem: str | None) -> None:
        if problem is not None and problem != self._problem:
            logger.warning("%s", problem)
        self._problem = problem

    def _try(self, *, stopped: bool) -> str | None:
        """Bring the disk in line; why it failed."""
        try:
            if stopped:
                self._store.set(wall=_wall(), reason="emergency stop requested")
            else:
                self._store.clear()
        except OSError as error:
            told = "is not on disk" if stopped else "cannot be removed from the disk, the next start will be in it"
            return f"the emergency stop {told}: {_words(error)}"
        return None


def _parse(text: bytes, path: Path) -> Kept:
    try:
        document = json.loads(text)
        when, reason = datetime.fromisoformat(document["set_wall"]), str(document["reason"])
    except (ValueError, TypeError, KeyError):
        return Kept(f"assumed to be set, because {path} is malformed", sound=False)
    return Kept(f"{reason}, set {when.isoformat(timespec='seconds')}, before this start", sound=True)


def _text(path: Path) -> bytes:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        return os.read(descriptor, LONGEST)
    finally:
        os.close(descriptor)


def _make(directory: Path) -> None:
    """With its parents, each of them on the disk."""
    if directory.is_dir():
        return
    _make(directory.parent)
    directory.mkdir(exist_ok=True)
    _sync(directory.parent)


def _sync(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _wall() -> str:
    return datetime.fromtimestamp(clock_gettime(CLOCK_REALTIME), UTC).isoformat(timespec="milliseconds")


def _words(error: OSError) -> str:
    return error.strerror or str(error)
