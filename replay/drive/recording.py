"""Records a drive in virtual time with the recorder's own writer and the stamps of the virtual clock."""

import shutil
from collections.abc import Callable
from pathlib import Path

from gateway.config import RobotConfig
from gateway.core.snapshot import State
from gateway.recording.disk import free_bytes
from gateway.recording.failures import WriterDeadError
from gateway.recording.packets import SNAPSHOT_PERIOD_NS, Hello, Record, Snapshot
from gateway.recording.recorder import RecorderError
from gateway.recording.writer import SessionWriter
from gateway.types import CycleTiming, Inputs, Outputs
from replay.drive.closed_loop import FIRST_NS
from replay.sim.plants.contract import PlantName

BATCH = 250  # cycles
ROOM = 16_000_000  # bytes: more than a batch takes, and what closes a segment


def check_room(folder: Path) -> None:
    """Whether there is room for what follows: a full disk ends a session's writer for good. Raises RecorderError."""
    free = free_bytes(folder)
    if free < ROOM:
        raise RecorderError(f"disk full: {free} bytes free at {folder}, {ROOM} are needed")


def discard(writer: SessionWriter, why: BaseException) -> None:
    """Leave nothing of what was written. A writer that is dead is not touched again, as it asks for."""
    if not isinstance(why, WriterDeadError) and not writer.report().closed:
        writer.close(ended=False)
    shutil.rmtree(writer.folder, ignore_errors=True)


class SessionRecording:
    """A session in a directory, and another one after each restart of the process. `session`: the last one.

    `started_wall_ns`: the wall time of the first cycle; later ones follow in virtual time. `plant`: by what the
    robot moves; None: by none that has a name. `imported`: of which log these are the frames; None: of none.
    """

    def __init__(
        self,
        config: RobotConfig,
        text: str,
        origin: str,
        *,
        directory: Path,
        started_wall_ns: int,
        plant: PlantName | None = None,
        imported: str | None = None,
    ) -> None:
        settings = config.recording.model_copy(update={"directory": str(directory)})
        self._config = config.model_copy(update={"recording": settings})
        self._text = text
        self._origin = origin
        self._plant = plant
        self._imported = imported
        self._wall_minus_mono_ns = started_wall_ns - FIRST_NS
        self._now_ns = FIRST_NS
        self._waiting: list[Record] = []
        self._snapshot: Snapshot | None = None
        self._snapshot_due_ns = 0
        self._writer = self._begin()

    @property
    def session(self) -> Path:
        """Folder of the session being written."""
        return self._writer.folder

    def put(self, inputs: Inputs, outputs: Outputs, state: Callable[[], State]) -> None:
        """One cycle; no time was spent on it. `state`: of the core behind it. Raises RecorderError."""
        self._now_ns = inputs.now_ns
        timing = CycleTiming(late_ns=0, work_ns=0, wall_ns=inputs.now_ns + self._wall_minus_mono_ns)
        self._waiting.append(Record(inputs, outputs, timing))
        if len(self._waiting) >= BATCH:
            self._write()
            if inputs.now_ns >= self._snapshot_due_ns:
                self._snapshot_due_ns = inputs.now_ns + SNAPSHOT_PERIOD_NS
                self._snapshot = Snapshot.of(inputs.cycle, state())

    def restart(self) -> None:
        """The process that follows records a session of its own."""
        self.close()
        self._writer = self._begin()

    def close(self) -> None:
        """Everything on the disk, with a footer. Raises RecorderError if it is not."""
        self._write()
        self._snapshot = None
        self._writer.close()
        report = self._writer.report()
        if report.lost:
            raise RecorderError(f"{report.lost} cycles are not in {report.folder}: {report.error}")

    def discard(self, why: BaseException) -> None:
        """Instead of `close`: nothing of the session stays."""
        discard(self._writer, why)

    def _begin(self) -> SessionWriter:
        hello = Hello(
            config_json=self._config.model_dump_json(),
            config_text=self._text,
            config_origin=self._origin,
            folder=None,
            started_wall_ns=self._now_ns + self._wall_minus_mono_ns,
            wall_minus_mono_ns=self._wall_minus_mono_ns,
            plant=None if self._plant is None else self._plant.value,
            imported=self._imported,
        )
        return SessionWriter(self._config, hello)

    def _write(self) -> None:
        if self._waiting:
            check_room(self.session)
            self._writer.write(self._waiting, (), self._snapshot)
            self._waiting, self._snapshot = [], None
