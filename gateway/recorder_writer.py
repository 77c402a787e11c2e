"""A session on the disk: segments one after the other, within the limits of the robot file.

How this works
--------------
Records come in batches. A batch goes to the open segment; a segment that is old or big enough is closed and the next
batch opens a new one. Without room on the disk the segment is closed and what comes is counted as lost until there
is room again; the gap is then written in front of what follows. A dead writing thread ends this process
(WriterDeadError goes through): the service starts a new one, which goes on in the same folder.
"""

import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import rerun as rr

from gateway.blueprint import blueprint
from gateway.config import RobotConfig
from gateway.record import Gap, Hello, Record, Report
from gateway.recorder_disk import Syncer, free_bytes, new_session, next_segment, prune, segment_path, sync
from gateway.recorder_header import header
from gateway.recorder_segment import Segment
from gateway.recorder_shapes import reach
from gateway.recorder_views import Views

logger = logging.getLogger(__name__)

EYE_HEIGHTS = 10.0  # of the eye above the robot, in radii of its body
_BAD_VALUE = (OverflowError, TypeError, ValueError)


class SessionWriter:
    """Makes or goes on with a session folder. Raises OSError when the folder cannot be made."""

    def __init__(self, config: RobotConfig, hello: Hello, *, free: Callable[[Path], int] = free_bytes) -> None:
        rr.set_strict_mode(True)  # a mistake in a column is an error, not a warning and a hole
        directory = Path(config.recording.directory)
        name = config.robot.name
        self.folder = Path(hello.folder) if hello.folder else new_session(directory, name, hello.started_wall_ns)
        self._limits = config.recording
        self._free = free
        self._header = header(hello, session=self.folder.name, robot=name)
        self._views = Views(config)
        self._blueprint = blueprint(eye_height=EYE_HEIGHTS * reach(config))
        self._syncer = Syncer()
        self._segment: Segment | None = None
        self._number = 0
        self._opened_ns = 0
        self._gaps: list[Gap] = []
        self._records = 0
        self._lost = 0
        self._settled_cycle: int | None = None
        self._error: str | None = None
        self._closed = False

    def report(self) -> Report:
        """How the session stands."""
        return Report(
            folder=str(self.folder),
            segment=self._number,
            records=self._records,
            settled_cycle=self._settled_cycle,
            lost=self._lost,
            error=self._error or self._syncer.error,
            closed=self._closed,
        )

    def open(self) -> None:
        """Have a segment open if the disk allows it; otherwise `report` says why not. Raises RecordingOffError."""
        if self._segment is not None:
            return
        if self._room():
            self._open()

    def write(self, records: Sequence[Record], gaps: Sequence[Gap] = ()) -> None:
        """Write a batch or count it as lost. Raises WriterDeadError, RecordingOffError."""
        self._gaps += gaps
        if not self._room():
            self._close_segment()
        elif self._segment is None:
            self._open()
        if self._segment is None:
            self._lose(records, self._error or "no segment")
        else:
            self._write(self._segment, records)
            self._segment.flush()
            self._rotate_if_due(self._segment)
        self._records += len(records)
        self._settled_cycle = records[-1].inputs.cycle if records else self._settled_cycle

    def close(self) -> None:
        """Footer, last sync. Raises WriterDeadError."""
        if self._gaps:
            self.write(())
        self._close_segment()
        self._syncer.close()
        self._closed = True

    def _room(self) -> bool:
        """Whether there is room to write; says so once when that changes."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
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
            self._prune()
            number = next_segment(self.folder)
            path = segment_path(self.folder, number)
            numbered = msgspec.structs.replace(self._header, segment=number)
            self._segment = Segment(path, header=numbered, views=self._views, blueprint=self._blueprint)
        except OSError as error:
            self._fail(f"cannot open a segment in {self.folder}: {error}")
            return
        self._number = number
        self._opened_ns = time.monotonic_ns()
        self._syncer.watch(path)
        self._error = None

    def _prune(self) -> None:
        directory = self.folder.parent
        for gone in prune(directory, current=self.folder, budget=self._limits.disk_budget):
            logger.warning("deleted old session %s: recording.disk_budget is reached", gone.name)

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

    def _rotate_if_due(self, segment: Segment) -> None:
        age_s = (time.monotonic_ns() - self._opened_ns) * 1e-9
        size = segment.size()
        if size is None or size >= self._limits.segment_bytes or age_s >= self._limits.segment_seconds:
            self._close_segment()

    def _close_segment(self) -> None:
        if self._segment is None:
            return
        self._segment.close()
        self._syncer.watch(None)
        try:
            sync(self._segment.path)
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
