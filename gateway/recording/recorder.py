"""The service's side of the recording: hands every cycle to the recorder process and never waits for it.

How this works
--------------
One packet per cycle goes into a socket pair. When the pair is full the packet waits in a bounded backlog; when that
is full too the cycle is lost, counted, and the next cycle that goes through is preceded by a marker of the gap.
The process reports back on the same pair. If it dies, driving goes on: `poll` starts another one, which goes on in
the same session folder; what the dead one had not confirmed is marked as a gap.

Neither this module nor anything it imports knows Rerun, which would cost the service memory and start-up time.
"""

import logging
import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import NamedTuple

from gateway.config import RobotConfig
from gateway.core.snapshot import State
from gateway.errors import UserError
from gateway.recording.child import RecorderChild, TooLongError, recorder_spawner
from gateway.recording.packets import (
    SNAPSHOT_PERIOD_NS,
    End,
    Gap,
    Hello,
    IncidentReport,
    Record,
    Snapshot,
    encode,
)
from gateway.types import CycleTiming, Event, Inputs, Level, Outputs

logger = logging.getLogger(__name__)

READY_TIMEOUT_S = 5.0  # a slow one is waited for no longer: it must not keep the robot from starting
CLOSE_TIMEOUT_S = 10.0
BACKLOG_SECONDS = 8.0  # outlasts a stalled disk and the start of a new recorder process
BACKLOG_BYTES = 16_000_000
BACKLOG_SENDS = 4  # of waiting packets per cycle: catching up must not make the loop late, nor all be lost at once
FIRST_BACKOFF_S = 1.0
LONGEST_BACKOFF_S = 30.0
ENDS: dict[int | None, str] = {
    -signal.SIGALRM: "writing was stuck",
    None: "nobody tells how",
}  # exit codes that deserve words
NO_INCIDENTS = IncidentReport(0, 0, None, None, pending=False)


class RecorderError(UserError):
    """The recorder process could not be started; the text says why."""


class _Waiting(NamedTuple):
    cycle: int | None  # None: a gap marker, a snapshot, or the end
    packet: bytes


class Recorder:
    """Starts the recorder process and waits for it, but not for long. Raises RecorderError when it refuses."""

    def __init__(
        self, config: RobotConfig, config_text: str, config_origin: str = "robot file", *, plant: str | None = None
    ) -> None:
        wall_ns, mono_ns = time.clock_gettime_ns(time.CLOCK_REALTIME), time.monotonic_ns()
        self.session: Path | None = None
        self.error: str | None = None
        self._hello = Hello(
            config_json=config.model_dump_json(),
            config_text=config_text,
            config_origin=config_origin,
            folder=None,
            started_wall_ns=wall_ns,
            wall_minus_mono_ns=wall_ns - mono_ns,
            plant=plant,
        )
        self._backlog: deque[_Waiting] = deque()
        self._backlog_bytes = 0
        self._backlog_limit = int(BACKLOG_SECONDS * config.loop.rate)
        self._gap: Gap | None = None
        self._dropped = 0  # apart from what the running process has lost
        self._backoff_s = FIRST_BACKOFF_S
        self._retry_at = 0.0
        self._starting = False
        self._snapshot_due_ns = 0
        self._keeps_incidents = config.recording.incidents.enabled
        self._incidents = NO_INCIDENTS
        self._kept = self._failed = 0  # incidents, by the processes before
        self._events: list[Event] = []
        self._orders: SimpleQueue[Hello | None] = SimpleQueue()
        self._started: SimpleQueue[RecorderChild | OSError] = SimpleQueue()
        self._spawner = recorder_spawner()
        self._child: RecorderChild | None = RecorderChild(self._hello, self._spawner)
        self._wait_until_ready(self._child)
        # A thread that is there already: starting one waits until it runs, and the disk with the program may hang.
        Thread(target=self._start_others, name="recorder start", daemon=True).start()

    @property
    def dropped(self) -> int:
        """Cycles that are not in the recording, for whatever reason, since start."""
        return self._dropped + (self._child.report.lost if self._child is not None and self._child.report else 0)

    @property
    def alive(self) -> bool:
        """Whether a recorder process is running."""
        return self._child is not None and self._child.running()

    def health(self) -> dict[str, object]:
        """For the robot's status."""
        return {
            "session": None if self.session is None else str(self.session),
            "alive": self.alive,
            "dropped": self.dropped,
            "error": self.error,
            "incidents": self._incident_health() if self._keeps_incidents else None,
        }

    def _incident_health(self) -> dict[str, object]:
        now = self._incidents
        return now._replace(kept=self._kept + now.kept, failed=self._failed + now.failed)._asdict()

    def put(
        self, inputs: Inputs, outputs: Outputs, timing: CycleTiming, state: Callable[[], State] | None = None
    ) -> None:
        """Record one cycle, and every few seconds the state of the core behind it. Never waits.

        Raises only what `state` raises.
        """
        self._put(inputs, outputs, timing)
        if state is not None and inputs.now_ns >= self._snapshot_due_ns:
            self._snapshot_due_ns = inputs.now_ns + SNAPSHOT_PERIOD_NS
            self._put_snapshot(Snapshot.of(inputs.cycle, state()))

    def _put_snapshot(self, snapshot: Snapshot) -> None:
        """In its place behind its cycle; left out while cycles are being lost, for it can wait."""
        if self._gap is not None:
            return
        packet = encode(snapshot)
        if self._backlog or not self._ready() or not self._send(None, packet):
            self._append(_Waiting(None, packet))

    def _put(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None:
        try:
            packet = encode(Record(inputs, outputs, timing))
        except (TypeError, ValueError, OverflowError) as error:
            self._lose(inputs.cycle, f"not recordable: {error}")
            return
        if self._backlog or self._gap is not None:
            self._catch_up()
            self._keep(inputs.cycle, packet)
        elif not self._ready() or not self._send(inputs.cycle, packet):
            self._keep(inputs.cycle, packet)

    def poll(self) -> Sequence[Event]:
        """Take in reports, replace a dead process, catch up; tells of incidents that were kept, and that were not.

        Never waits; call it a few times per second.
        """
        if self._child is not None:
            self._child.receive()
            self._take_report(self._child)
            if not self._child.running():
                self._bury(self._child)
        elif self._starting:
            self._take_started()
        elif time.monotonic() >= self._retry_at:
            self._starting = True
            self._orders.put(self._hello)
        self._catch_up()
        events, self._events = self._events, []
        return events

    def close(self, timeout: float = CLOSE_TIMEOUT_S) -> bool:
        """Flush, write the footer, end the process; False if something is not on the disk by then."""
        self._orders.put(None)
        try:
            return self._close_child(timeout)
        finally:
            self._spawner.close()

    def _close_child(self, timeout: float) -> bool:
        deadline = time.monotonic() + timeout
        child = self._child
        if child is None:
            return False
        self._append_gap()
        self._append(_Waiting(None, encode(End())))
        while self._backlog and child.wait_writable(deadline - time.monotonic()):
            self._send_backlog(len(self._backlog))
        complete = not self._backlog and self._gap is None
        child.finish(deadline)
        self._take_report(child)
        ended = child.exit_code(deadline) == 0 and child.report is not None and child.report.closed
        self._dropped, self._child = self.dropped, None
        return complete and ended

    def _wait_until_ready(self, child: RecorderChild) -> None:
        deadline = time.monotonic() + READY_TIMEOUT_S
        while child.report is None and not child.ended and child.wait_readable(deadline - time.monotonic()):
            child.receive()
        report = child.report
        if report is None and not child.ended:
            self.error = f"the recorder process was not ready within {READY_TIMEOUT_S:g} s"
            logger.warning("%s: driving goes on, cycles wait for it", self.error)
            return
        if report is None or report.closed:
            child.kill()
            self._spawner.close()
            raise RecorderError(report.error if report is not None and report.error else "the recorder process ended")
        self._take_report(child)
        logger.info("recording to %s", self.session or "no session: incidents only")

    def _take_report(self, child: RecorderChild) -> None:
        report = child.report
        if report is None:
            return
        self._take_incidents(report.incidents or NO_INCIDENTS)
        if report.folder:
            self.session = self.session or Path(report.folder).absolute()
            self._hello = self._hello._replace(folder=str(self.session), chain=report.chain)
        if report.error != self.error:
            if report.error is not None:
                logger.warning("recording: %s", report.error)
            else:
                logger.info("recording goes on, segment %d", report.segment)
            self.error = report.error
        if report.records:
            self._backoff_s = FIRST_BACKOFF_S

    def _take_incidents(self, now: IncidentReport) -> None:
        before, self._incidents = self._incidents, now
        if now.kept > before.kept:
            self._events.append(Event(Level.INFO, "incident", str(now.file)))
        if now.failed > before.failed:
            self._events.append(Event(Level.WARNING, "incident_lost", str(now.error)))

    def _lose_incident(self, reason: str) -> None:
        """What the dead process has not given to another one is gone with it; what it has may still be written."""
        before = self._incidents
        self._kept, self._failed = self._kept + before.kept, self._failed + before.failed
        self._incidents = NO_INCIDENTS._replace(file=before.file, error=before.error)
        if before.pending:
            self._failed += 1
            error = f"an incident may not be kept: {reason}"
            self._incidents = self._incidents._replace(error=error)
            self._events.append(Event(Level.WARNING, "incident_lost", error))

    def _bury(self, child: RecorderChild) -> None:
        """What the dead process had taken and not confirmed is lost."""
        child.receive()
        self._take_report(child)
        confirmed = child.report.records if child.report is not None else 0
        settled = child.report.settled_cycle if child.report is not None else None
        code = child.exit_code(0.0)
        reason = f"the recorder process ended ({ENDS.get(code, f'exit code {code}')})"
        self._dropped += child.sent - confirmed + (child.report.lost if child.report is not None else 0)
        if child.sent > confirmed and child.first_cycle is not None and child.last_cycle is not None:
            first = child.first_cycle if settled is None else settled + 1
            marker = _Waiting(None, encode(Gap(first, child.last_cycle, reason)))
            self._backlog.appendleft(marker)
            self._backlog_bytes += len(marker.packet)
        self.error = self.error or reason
        logger.warning("%s; next attempt in %g s", reason, self._backoff_s)
        self._lose_incident(reason)
        self._child = None
        self._snapshot_due_ns = 0  # the next process knows no state yet, from which an incident could begin
        self._retry_at = time.monotonic() + self._backoff_s
        self._backoff_s = min(2 * self._backoff_s, LONGEST_BACKOFF_S)

    def _start_others(self) -> None:
        while (hello := self._orders.get()) is not None:
            try:
                self._started.put(RecorderChild(hello, self._spawner))
            except OSError as error:
                self._started.put(error)

    def _take_started(self) -> None:
        if self._started.empty():
            return
        self._starting = False
        started = self._started.get()
        if isinstance(started, RecorderChild):
            self._child = started
            return
        self._retry_at = time.monotonic() + self._backoff_s
        self.error = f"the recorder process cannot be started: {started}"

    def _keep(self, cycle: int, packet: bytes) -> None:
        """Into the backlog; once that was full, only when half of it has gone, so that gaps are few and long."""
        limit = self._backlog_limit if self._gap is None else self._backlog_limit // 2
        if len(self._backlog) >= limit or self._backlog_bytes + len(packet) > BACKLOG_BYTES:
            self._lose(cycle, "the recorder could not keep up")
            return
        self._append_gap()
        self._append(_Waiting(cycle, packet))

    def _append_gap(self) -> None:
        if self._gap is not None:
            self._append(_Waiting(None, encode(self._gap)))
            self._gap = None

    def _append(self, waiting: _Waiting) -> None:
        self._backlog.append(waiting)
        self._backlog_bytes += len(waiting.packet)

    def _ready(self) -> bool:
        """Whether the process has said that it records: until then nothing is handed over, which dies with it."""
        return self._child is not None and self._child.report is not None

    def _catch_up(self) -> None:
        if self._ready():
            self._send_backlog(BACKLOG_SENDS)

    def _send_backlog(self, limit: int) -> None:
        if not self._backlog:
            self._append_gap()
        for _ in range(min(limit, len(self._backlog))):
            cycle, packet = self._backlog[0]
            if not self._send(cycle, packet):
                return
            self._backlog.popleft()
            self._backlog_bytes -= len(packet)

    def _send(self, cycle: int | None, packet: bytes) -> bool:
        """Whether the packet is off our hands: handed over, or lost because nothing could ever take it."""
        if self._child is None:
            return False
        try:
            return self._child.send(cycle, packet)
        except TooLongError as error:
            if cycle is not None:
                self._lose(cycle, f"not recordable: {error}")
            return True

    def _lose(self, cycle: int, reason: str) -> None:
        self._dropped += 1
        if self._gap is None:
            self._gap = Gap(cycle, cycle, reason)
        else:
            self._gap = Gap(self._gap.first_cycle, cycle, self._gap.reason)


class NullRecorder:
    """Stands in where the robot file wants neither sessions nor incidents."""

    session: Path | None = None
    error: str | None = None
    dropped = 0
    alive = False

    def put(
        self, inputs: Inputs, outputs: Outputs, timing: CycleTiming, state: Callable[[], State] | None = None
    ) -> None:
        """Forget it."""

    def poll(self) -> Sequence[Event]:
        """Nothing to do."""
        return ()

    def health(self) -> dict[str, object]:
        """For the robot's status."""
        return {"session": None, "alive": False, "dropped": 0, "error": None, "incidents": None}

    def close(self, timeout: float = 0.0) -> bool:
        """Nothing is left behind."""
        return True
