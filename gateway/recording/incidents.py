"""The recorder process's watch over what somebody would look for, and the seconds around it on their way to the disk.

How this works
--------------
A ring (`gateway.recording.ring`) holds the last seconds. A cause opens a window around itself; another one within it
moves its end, by no more than the time that is kept in front: what goes on longer is the next incident.
When a window ends, its part of the ring is given to a process of its own (`gateway.recording.bundle`) in a file in
memory, which takes a copy and no waiting; one at a time, while the next windows wait in the ring. What comes of it is
asked for, never waited for. At the end windows end where the drive does, and their processes outlive this one.

Times are those of the cycles. Nothing here knows Rerun.
"""

import logging
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Protocol

import msgspec

from gateway.config import RobotConfig
from gateway.recording.incident import MOST_CAUSES, Buses, BusState, Cause, Incident, causes, hidden
from gateway.recording.packets import Gap, Hello, IncidentReport, Packet, Record, Snapshot, encode
from gateway.recording.ring import Ring
from gateway.types import Mode

logger = logging.getLogger(__name__)

PROGRAM = ("-m", "gateway.recording.bundle")
MOST_WINDOWS = 4  # open, or waiting for the process of the one before
WRITING_LIMIT_S = 300.0  # for one, of which it needs seconds on a computer at ease; then its process is ended
ENDED_SILENTLY = "the process that writes it ended without a word (exit code {})"
STUCK = "writing was stuck"


class Order(msgspec.Struct, frozen=True):
    """What the writing process gets. `session`: name of the one that it is a part of; `end_ns`: of its last cycle."""

    hello: Hello
    session: str | None
    incident: Incident
    end_ns: int
    pieces: list[bytes]


class Written(msgspec.Struct, frozen=True):
    """What it answers: the file, or why there is none."""

    file: str | None
    verdict: str | None
    error: str | None


class Keeper(Protocol):
    """What the recorder process needs of it."""

    def take(self, packet: Packet, raw: bytes) -> None: ...

    def poll(self) -> bool: ...

    def report(self) -> IncidentReport | None: ...

    def close(self) -> None: ...


class NoIncidents:
    """Stands in where the robot file wants none."""

    def take(self, packet: Packet, raw: bytes) -> None:
        """Forget it."""

    def poll(self) -> bool:
        """Nothing is new."""
        return False

    def report(self) -> IncidentReport | None:
        """There is nothing to tell."""
        return None

    def close(self) -> None:
        """Nothing is left."""


@dataclass(slots=True)
class _Window:
    first: Cause
    end_ns: int
    limit_ns: int
    buses: tuple[BusState, ...]
    causes: list[Cause] = field(default_factory=list)
    more: int = 0

    def add(self, cause: Cause, post_ns: int) -> None:
        self.end_ns = max(self.end_ns, cause.now_ns + post_ns)
        if len(self.causes) < MOST_CAUSES:
            self.causes.append(cause)
        else:
            self.more += 1

    def incident(self) -> Incident:
        return Incident(tuple(self.causes), self.more, self.buses)


class WritingProcess:
    """Writes one incident, or says why not. Raises OSError when it cannot be started."""

    def __init__(self, order: bytes) -> None:
        with ExitStack() as opened:
            given = os.memfd_create("incident")
            opened.callback(os.close, given)
            ours, theirs = os.pipe()
            opened.callback(os.close, theirs)
            lost = opened.enter_context(ExitStack())
            lost.callback(os.close, ours)
            with os.fdopen(given, "wb", closefd=False) as file:
                file.write(order)
            os.lseek(given, 0, os.SEEK_SET)
            self._process = subprocess.Popen(
                [sys.executable, "-P", *PROGRAM, str(given), str(theirs)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(given, theirs),
            )
            lost.pop_all()
        self._answer = ours
        self._deadline = time.monotonic() + WRITING_LIMIT_S

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def written(self) -> Written | None:
        """What came of it; None: it is still at work. Never waits."""
        if time.monotonic() >= self._deadline:
            self._process.kill()
        code = self._process.poll()
        if code is None:
            return None
        with os.fdopen(self._answer, "rb") as answer:
            told = answer.read()
        try:
            return msgspec.msgpack.decode(told, type=Written)
        except msgspec.DecodeError:
            return Written(None, None, STUCK if code == -signal.SIGALRM else ENDED_SILENTLY.format(code))


class Incidents:
    """One writer. `session`: name of the session that is recorded beside it; `write`: starts the process."""

    def __init__(
        self,
        config: RobotConfig,
        hello: Hello,
        session: str | None,
        *,
        write: Callable[[bytes], WritingProcess] = WritingProcess,
    ) -> None:
        wanted = config.recording.incidents
        self._hello = hello
        self._session = session
        self._pre_ns, self._post_ns = round(1e9 * wanted.pre), round(1e9 * wanted.post)
        self._ring = Ring()
        self._buses = Buses([bus.name for bus in config.bus])
        self._windows: deque[_Window] = deque()
        self._write = write
        self._process: WritingProcess | None = None
        self._now_ns = 0
        self._mode: Mode | None = None  # of the last cycle; None: there was none
        self._behind_gap = False
        self._kept = self._failed = 0
        self._file: str | None = None
        self._error: str | None = None
        self._news = False

    def take(self, packet: Packet, raw: bytes) -> None:
        """One packet of the service, decoded and as it came."""
        if isinstance(packet, Record):
            self._now_ns = packet.inputs.now_ns
            self._ring.cycle(raw, self._now_ns)
            self._buses.hear(packet)
            for cause in self._causes(packet):
                self._hear(cause)
            if self._windows and self._now_ns >= self._windows[0].end_ns:
                self._start()
        elif isinstance(packet, Snapshot):
            self._ring.snapshot(raw)
        elif isinstance(packet, Gap):
            self._ring.gap(raw)
            self._behind_gap = True

    def poll(self) -> bool:
        """Forget, and ask what became of what is being written; whether there is news. Never waits."""
        wanted_ns = self._windows[0].first.now_ns if self._windows else self._now_ns
        self._ring.forget(wanted_ns - self._pre_ns)
        written = None if self._process is None else self._process.written()
        if written is not None:
            self._process = None
            self._settle(written)
            if self._windows and self._now_ns >= self._windows[0].end_ns:
                self._start()
        news, self._news = self._news, False
        return news

    def report(self) -> IncidentReport:
        """How they stand."""
        return IncidentReport(self._kept, self._failed, self._file, self._error, bool(self._windows or self._process))

    def close(self) -> None:
        """The drive has ended: windows end here. What writes them is not waited for."""
        self._process = None
        while self._windows:
            self._give(self._windows.popleft())

    def _causes(self, record: Record) -> list[Cause]:
        found = list(causes(record))
        if self._behind_gap and self._mode is not None and not found:
            found += hidden(record, self._mode)
        self._behind_gap, self._mode = False, record.outputs.mode
        return found

    def _hear(self, cause: Cause) -> None:
        last = self._windows[-1] if self._windows else None
        if last is not None and cause.now_ns < last.end_ns and cause.now_ns + self._post_ns <= last.limit_ns:
            last.add(cause, self._post_ns)
            return
        self._news = True
        if len(self._windows) >= MOST_WINDOWS:
            self._lose(f"{cause.code}: {MOST_WINDOWS} others are still to be written")
            return
        end_ns = cause.now_ns + self._post_ns
        window = _Window(cause, end_ns, end_ns + self._pre_ns, self._buses.states())
        window.add(cause, self._post_ns)
        self._windows.append(window)

    def _start(self) -> None:
        """Write the first window, unless another one is being written."""
        if self._process is None:
            self._process = self._give(self._windows.popleft())

    def _give(self, window: _Window) -> WritingProcess | None:
        since_ns = window.first.now_ns - self._pre_ns
        order = Order(self._hello, self._session, window.incident(), window.end_ns, self._ring.since(since_ns))
        try:
            return self._write(encode(order))
        except OSError as error:
            self._lose(f"{window.first.code}: the process that writes it cannot be started: {error.strerror}")
            return None

    def _settle(self, written: Written) -> None:
        self._news = True
        if written.file is None:
            self._lose(str(written.error))
            return
        self._kept += 1
        self._file, self._error = written.file, None
        logger.info("incident kept: %s (%s)", written.file, written.verdict)

    def _lose(self, reason: str) -> None:
        self._failed += 1
        self._error = f"an incident is not kept: {reason}"
        logger.warning("%s", self._error)


def keeper(config: RobotConfig, hello: Hello, session: str | None) -> Keeper:
    """As the robot file wants it."""
    return Incidents(config, hello, session) if config.recording.incidents.enabled else NoIncidents()
