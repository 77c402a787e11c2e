"""One segment of a session: a Rerun file with its own header, seal and footer. Nothing else writes to Rerun.

Rerun's messages carry no checksum, and two of three flipped bits in them read back as other numbers (measured with
0.41). So the last message is a seal: length and CRC of everything in front of it, read back from what was written.
"""

import logging
import zlib
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

import msgspec
import rerun as rr
import rerun.blueprint as rrb

from gateway.recording.block import packed
from gateway.recording.chain import beginning, link
from gateway.recording.columns import Times, arrays
from gateway.recording.disk import FILE_MODE
from gateway.recording.failures import RecordingOffError, WriterDeadError
from gateway.recording.packets import Gap, Record, Snapshot
from gateway.recording.schema import (
    APPLICATION_ID,
    BLOCK_ARCHETYPE,
    BLOCK_COLUMNS,
    BLOCK_PATH,
    CYCLE,
    FOOTER_MARK,
    FOOTER_TAIL,
    GAP_ARCHETYPE,
    GAP_COLUMNS,
    GAP_PATH,
    HEADER_ARCHETYPE,
    HEADER_COLUMNS,
    HEADER_PATH,
    SEAL_ARCHETYPE,
    SEAL_COLUMNS,
    SEAL_PATH,
    SNAPSHOT_ARCHETYPE,
    SNAPSHOT_COLUMNS,
    SNAPSHOT_PATH,
    Header,
)
from gateway.recording.views import Views

logger = logging.getLogger(__name__)

FLUSH_TIMEOUT_S = 3.0
DRAW_NS = 900_000_000  # of cycles are drawn at once, at least: each entity costs a kilobyte every time
FOOTER_BYTES = 135_000  # and this many for each batch; measured with Rerun 0.41 and the views of today
FOOTER_BYTES_PER_BATCH = 1000
_PIECE = 1 << 20  # read at a time


class Segment:
    """Opened on construction, header first; `views` None: nothing is drawn. Raises RecordingOffError, OSError."""

    def __init__(self, path: Path, *, header: Header, views: Views | None, blueprint: rrb.Blueprint | None) -> None:
        self.path = path
        self._views = views
        self._recording = rr.RecordingStream(APPLICATION_ID, recording_id=header.session, send_properties=False)
        if not rr.is_enabled(recording=self._recording):
            raise RecordingOffError("Rerun is switched off (RERUN=off in the environment): nothing can be recorded")
        try:
            self._recording.save(path, default_blueprint=blueprint)
        except RuntimeError as error:
            raise OSError(str(error)) from None
        path.chmod(FILE_MODE)
        self._file = path.open("rb", buffering=0)
        self._bytes = self._crc32 = 0  # of what has been written
        self._sha256 = sha256()
        self._tail = b""
        self.batches = 0  # written so far
        text = msgspec.json.encode(header).decode()
        self.chain = beginning(text)  # so far
        self._undrawn: list[Record] = []
        self._undrawn_gaps: list[Gap] = []
        self._send_header(header, text)
        if views is not None:
            views.begin(self._recording, header.config_text)
        self.flush()

    def write(self, records: Sequence[Record], gaps: Sequence[Gap]) -> None:
        """Write a batch, whole or, when a value does not fit its column, not at all (OverflowError, ...)."""
        if records:
            self._write_records(records)
        if gaps:
            self._send_gaps(gaps)
        self.batches += 1
        self._draw_later(records, gaps)

    def _write_records(self, records: Sequence[Record]) -> None:
        stored = packed(records)
        chain = link(self.chain, records[0].inputs.cycle, len(records), stored)
        columns = arrays(BLOCK_COLUMNS, [(len(records), stored, self.chain, chain)])
        block = rr.DynamicArchetype.columns(archetype=BLOCK_ARCHETYPE, components=columns)
        first = records[0]
        when = Times([first.inputs.cycle], [first.timing.wall_ns]).at([0])
        self._recording.send_columns(BLOCK_PATH, when, block)
        self.chain = chain

    def _draw_later(self, records: Sequence[Record], gaps: Sequence[Gap]) -> None:
        """Pictures follow from what is written, and may be lost with the process: they come a second at a time."""
        if self._views is None:
            return
        if gaps:  # they are drawn in front of the first cycle behind them
            self._draw()
        self._undrawn += records
        self._undrawn_gaps += gaps
        if self._undrawn and self._undrawn[-1].inputs.now_ns - self._undrawn[0].inputs.now_ns >= DRAW_NS:
            self._draw()

    def _draw(self) -> None:
        if self._views is None or not self._undrawn:
            return
        records, gaps = self._undrawn, self._undrawn_gaps
        self._undrawn, self._undrawn_gaps = [], []
        try:
            self._views.send(self._recording, records, gaps)
        except (OverflowError, TypeError, ValueError) as error:
            first, last = records[0].inputs.cycle, records[-1].inputs.cycle
            logger.warning("cycles %d to %d are recorded, but not drawn: %s", first, last, error)

    def keep(self, snapshot: Snapshot) -> None:
        """Write the state of the core from which the next batch goes on."""
        cycle, stored = snapshot.cycle, snapshot.state
        chain = link(self.chain, cycle, 0, stored)
        columns = arrays(SNAPSHOT_COLUMNS, [(cycle, stored, zlib.crc32(stored), self.chain, chain)])
        state = rr.DynamicArchetype.columns(archetype=SNAPSHOT_ARCHETYPE, components=columns)
        self._recording.send_columns(SNAPSHOT_PATH, [rr.TimeColumn(CYCLE, sequence=[cycle])], state)
        self.chain = chain

    def flush(self) -> None:
        """Hand everything to the kernel. Raises WriterDeadError."""
        try:
            self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except RuntimeError as error:
            raise WriterDeadError(str(error)) from None
        self._read_back()

    def _read_back(self) -> None:
        while piece := self._file.read(_PIECE):
            self._bytes += len(piece)
            self._crc32 = zlib.crc32(piece, self._crc32)
            self._sha256.update(piece)
            self._tail = (self._tail + piece)[-FOOTER_TAIL.size :]

    def size(self) -> int | None:
        """Bytes it would have if it were closed now; None if somebody has taken the file away."""
        if not self.path.exists():
            return None
        return self._bytes + FOOTER_BYTES + FOOTER_BYTES_PER_BATCH * self.batches

    def close(self, *, first_segment: int, final: bool, last_cycle: int | None) -> str:
        """Write what is not drawn yet, seal and footer; SHA-256 of the whole file, hex. Raises WriterDeadError."""
        self._draw()
        self.flush()
        seal = (self._bytes, self._crc32, first_segment, final, last_cycle, self.chain)
        columns = arrays(SEAL_COLUMNS, [seal])
        self._recording.log(SEAL_PATH, rr.DynamicArchetype(SEAL_ARCHETYPE, components=columns), static=True)
        self.flush()
        self._recording.disconnect()
        with self._file:
            self._read_back()
        if FOOTER_MARK not in self._tail:
            raise WriterDeadError("the footer is not in the file")  # Rerun only logs it
        return self._sha256.hexdigest()

    def _send_header(self, header: Header, text: str) -> None:
        self._recording.send_recording_name(header.session)
        self._recording.send_recording_start_time_nanos(header.started_wall_ns)
        columns = arrays(HEADER_COLUMNS, [(header.schema_version, text)])
        self._recording.log(HEADER_PATH, rr.DynamicArchetype(HEADER_ARCHETYPE, components=columns), static=True)

    def _send_gaps(self, gaps: Sequence[Gap]) -> None:
        rows = [(gap.first_cycle, gap.last_cycle, gap.reason) for gap in gaps]
        columns = rr.DynamicArchetype.columns(archetype=GAP_ARCHETYPE, components=arrays(GAP_COLUMNS, rows))
        when = rr.TimeColumn(CYCLE, sequence=[gap.first_cycle for gap in gaps])
        self._recording.send_columns(GAP_PATH, [when], columns)
