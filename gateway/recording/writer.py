"""A session on the disk: segments one after the other, within the limits of the robot file.

How this works
--------------
Records come in batches. A batch goes to the open segment; one that is old, or would become too big, is closed before
and the batch opens a new one. Room is made by deleting what is oldest, also of this session (`gateway.recording.disk`):
when a segment is opened, so that all of the robot's sessions stay within the budget, and when the disk runs full. If
that does not help, the segment is closed and what comes is counted as lost until there is room again; the gap is then
written in front of what follows. A dead writing thread ends this process (WriterDeadError goes through): the service
starts a new one, which goes on in the same folder.
"""

import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import rerun as rr

from gateway.config import RobotConfig
from gateway.recording.blueprint import blueprint
from gateway.recording.disk import (
    Disposable,
    Hold,
    Syncer,
    add_sum,
    delete,
    disposable,
    free_bytes,
    make_folder,
    new_session,
    next_segment,
    segment_number,
    segment_path,
    segments,
    stored_bytes,
    sync,
)
from gateway.recording.header import header
from gateway.recording.packets import SNAPSHOT_PERIOD_NS, Gap, Hello, Record, RecorderReport, Snapshot
from gateway.recording.schema import Header
from gateway.recording.segment import Segment
from gateway.recording.views import Views

logger = logging.getLogger(__name__)

_BAD_VALUE = (OverflowError, TypeError, ValueError)


class SessionWriter:
    """Makes or goes on with a session folder. Raises OSError when the folder cannot be made.

    `told`: what a header says of the software, in the place of what this process would say of itself.
    """

    def __init__(
        self,
        config: RobotConfig,
        hello: Hello,
        *,
        free: Callable[[Path], int] = free_bytes,
        told: Header | None = None,
    ) -> None:
        rr.set_strict_mode(True)  # a mistake in a column is an error, not a warning and a hole
        directory = Path(config.recording.directory)
        name = config.robot.name
        self.folder = Path(hello.folder) if hello.folder else new_session(directory, name, hello.started_wall_ns)
        self._hold = Hold(self.folder)
        self._robot = name
        self._limits = config.recording
        self._segment_bytes = min(self._limits.segment_bytes, self._limits.disk_budget // 2)
        self._free = free
        self._header = header(hello, session=self.folder.name, robot=name)
        if told is not None:
            self._header = msgspec.structs.replace(told, session=self.folder.name, segment=1, first_segment=1)
        self._views = Views(config)
        self._blueprint = blueprint(config)
        self._syncer = Syncer()
        self._segment: Segment | None = None
        self._number = 0
        self._first_segment = _first_segment(self.folder)
        self._largest_batch = 0
        self._opened_ns = 0
        self._snapshot_ns = -2 * SNAPSHOT_PERIOD_NS  # none has come
        self._gaps: list[Gap] = []
        self._records = 0
        self._lost = 0
        self._settled_cycle: int | None = None
        self._error: str | None = None
        self._closed = False
        self._chain = hello.chain

    def report(self) -> RecorderReport:
        """How the session stands."""
        return RecorderReport(
            folder=str(self.folder),
            segment=self._number,
            records=self._records,
            settled_cycle=self._settled_cycle,
            lost=self._lost,
            error=self._error or self._syncer.error,
            closed=self._closed,
            chain=self._chain,
        )

    def open(self) -> None:
        """Have a segment open if the disk allows it; otherwise `report` says why not. Raises RecordingOffError."""
        if self._segment is not None:
            return
        if self._room():
            self._open()

    def write(self, records: Sequence[Record], gaps: Sequence[Gap] = (), snapshot: Snapshot | None = None) -> None:
        """Write a batch or count it as lost. `snapshot`: the state in front of it, with which a segment best begins.

        Raises WriterDeadError, RecordingOffError.
        """
        self._gaps += gaps
        if not self._room() or self._rotation_is_due(snapshot):
            self._close_segment()
        self.open()
        if self._segment is None:
            self._lose(records, self._error or "no segment")
        else:
            before = self._segment.size() or 0
            if snapshot is not None:
                self._segment.keep(snapshot)
                self._snapshot_ns = time.monotonic_ns()
            self._write(self._segment, records)
            self._segment.flush()
            self._syncer.written()
            self._chain = self._segment.chain.hex()
            self._largest_batch = max(self._largest_batch, (self._segment.size() or 0) - before)
        self._records += len(records)
        self._settled_cycle = records[-1].inputs.cycle if records else self._settled_cycle

    def close(self, *, ended: bool = True) -> None:
        """Seal, footer, last sync; `ended`: the service says that nothing is missing. Raises WriterDeadError."""
        if self._gaps:
            self.write(())
        self._close_segment(final=ended)
        self._syncer.close()
        self._hold.release()
        self._closed = True

    def _room(self) -> bool:
        """Whether there is room to write, after making some if that helps; says so once when that changes."""
        try:
            if not self.folder.exists():  # somebody has taken it away
                self.folder.parent.mkdir(parents=True, exist_ok=True)
                make_folder(self.folder)
                self._hold.release()
                self._hold = Hold(self.folder)
            free = self._free(self.folder)
            if free < self._limits.min_free:
                self._free_disk(self._limits.min_free - free)
                free = self._free(self.folder)
        except OSError as error:
            self._fail(f"{self.folder}: {error.strerror}")
            return False
        if free < self._limits.min_free:
            self._fail(f"disk full: {free} bytes free at {self.folder}, recording.min_free is {self._limits.min_free}")
            return False
        if self._segment is not None:
            self._error = None
        return True

    def _open(self) -> None:
        try:
            self._keep_budget()
            number = max(next_segment(self.folder), self._number + 1)
            path = segment_path(self.folder, number)
            numbered = msgspec.structs.replace(
                self._header, segment=number, first_segment=self._first_segment, chain=self._chain
            )
            self._segment = Segment(path, header=numbered, views=self._views, blueprint=self._blueprint)
        except OSError as error:
            self._fail(f"cannot open a segment in {self.folder}: {error}")
            return
        self._number = number
        self._opened_ns = time.monotonic_ns()
        self._chain = self._segment.chain.hex()
        self._syncer.watch(path)
        self._error = None

    def _keep_budget(self) -> None:
        """Before a segment is opened there is room in the budget for the whole of it."""
        allowed = self._limits.disk_budget - self._segment_bytes
        excess = stored_bytes(self.folder.parent, self._robot) - allowed
        if excess > 0:
            self._delete(self._disposable(), excess, "recording.disk_budget is reached")

    def _free_disk(self, missing: int) -> None:
        """Nothing is deleted in vain, when others have filled the disk."""
        found = self._disposable()
        if sum(one.bytes for one in found) >= missing:
            self._delete(found, missing, "free space is below recording.min_free")

    def _disposable(self) -> list[Disposable]:
        writing = None if self._segment is None else self._segment.path
        return disposable(self.folder, self._robot, writing=writing)

    def _delete(self, found: Sequence[Disposable], excess: int, reason: str) -> None:
        for one in found:
            if excess <= 0:
                return
            delete(one)
            excess -= one.bytes
            if one.segment is not None:
                self._first_segment = max(self._first_segment, one.segment + 1)
            logger.warning("deleted %s: %s", one.path, reason)

    def _write(self, segment: Segment, records: Sequence[Record]) -> None:
        """One record with a value that no column holds must not cost its neighbours: halve until it stands alone."""
        try:
            segment.write(records, self._gaps)
        except _BAD_VALUE as error:
            if len(records) <= 1:
                self._lose(records, f"not recordable: {error}")
                return
            half = len(records) // 2
            self._write(segment, records[:half])
            self._write(segment, records[half:])
        else:
            self._gaps = []

    def _rotation_is_due(self, snapshot: Snapshot | None) -> bool:
        """Whether the open segment might grow too big with the next batch, or is too old.

        One that is only old waits for the next snapshot, so that the one after it begins with it, if they do come.
        """
        if self._segment is None:
            return False
        size = self._segment.size()
        age_s = (time.monotonic_ns() - self._opened_ns) * 1e-9
        full = size is None or (self._segment.batches > 0 and size + self._largest_batch > self._segment_bytes)
        if full or age_s < self._limits.segment_seconds:
            return full
        come = time.monotonic_ns() - self._snapshot_ns < 2 * SNAPSHOT_PERIOD_NS
        return snapshot is not None or not come

    def _close_segment(self, *, final: bool = False) -> None:
        if self._segment is None:
            return
        last = self._settled_cycle if final else None
        digest = self._segment.close(first_segment=self._first_segment, final=final, last_cycle=last)
        self._syncer.watch(None)
        try:
            sync(self._segment.path)
            add_sum(self._segment.path, digest)
        except OSError as error:
            self._fail(f"{self._segment.path}: {error.strerror}")
        self._segment = None

    def _lose(self, records: Sequence[Record], reason: str) -> None:
        if records:
            self._lost += len(records)
            self._gaps.append(Gap(records[0].inputs.cycle, records[-1].inputs.cycle, reason))

    def _fail(self, text: str) -> None:
        if text != self._error:
            logger.warning("%s", text)
        self._error = text


def _first_segment(folder: Path) -> int:
    """Of a session that goes on after the end of another recorder process: what is missing had been deleted."""
    present = segments(folder) if folder.is_dir() else []
    return (segment_number(present[0]) or 1) if present else 1
