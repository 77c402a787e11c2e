"""Sessions made for tests: written by the recorder's own writer, in this process or in its own."""

from collections.abc import Callable, Sequence
from pathlib import Path

from gateway.config import RobotConfig, parse
from gateway.core.engine import Engine
from gateway.recording.packets import Gap, Hello, Record, Snapshot
from gateway.recording.writer import SessionWriter
from gateway.types import CycleTiming, Inputs
from replay.sessions.reader import RecordedOutputs
from tests.world import World

ROBOT_FILE = Path(__file__).parent.parent / "deploy" / "robots" / "moby.toml"
STARTED_NS = 1_790_000_000_123_456_789
PLENTY = 10**15


def robot_text() -> str:
    return ROBOT_FILE.read_text(encoding="utf-8")


def robot(directory: Path, **recording: object) -> RobotConfig:
    return stored(parse(robot_text(), "moby.toml"), directory, **recording)


def stored(config: RobotConfig, directory: Path, **recording: object) -> RobotConfig:
    """The same robot with its sessions in this directory."""
    settings = config.recording.model_copy(
        update={"directory": str(directory), "min_free": 1_000_000, **recording}, deep=True
    )
    return config.model_copy(update={"recording": settings})


def hello(config: RobotConfig, folder: Path | None = None, text: str | None = None) -> Hello:
    return Hello(
        config_json=config.model_dump_json(),
        config_text=text or robot_text(),
        config_origin="moby.toml",
        folder=None if folder is None else str(folder),
        started_wall_ns=STARTED_NS,
        wall_minus_mono_ns=STARTED_NS - 5_000_000_000,
    )


def writer(
    directory: Path, *, free: Callable[[Path], int] = lambda _: PLENTY, folder: Path | None = None, **recording: object
) -> SessionWriter:
    config = robot(directory, **recording)
    return SessionWriter(config, hello(config, folder), free=free)


def write(directory: Path, records: Sequence[Record], *, batch: int = 100, gaps: Sequence[Gap] = ()) -> Path:
    """A closed session of one segment."""
    session = writer(directory)
    session.write(records[:batch], gaps)
    for start in range(batch, len(records), batch):
        session.write(records[start : start + batch])
    session.close()
    return session.folder


def world_writer(directory: Path, world: World, *, started_ns: int = STARTED_NS, **recording: object) -> SessionWriter:
    """For a drive of tests.world."""
    config = stored(world.config, directory, **recording)
    told = hello(config, text=world.text)._replace(started_wall_ns=started_ns)
    return SessionWriter(config, told, free=lambda _: PLENTY)


def write_drive(
    directory: Path,
    world: World,
    *,
    batch: int | None = None,
    started_ns: int = STARTED_NS,
    snapshots: bool = False,
    **recording: object,
) -> Path:
    """The closed session of a drive of tests.world; with `snapshots`, one in front of every batch but the first."""
    session = world_writer(directory, world, started_ns=started_ns, **recording)
    records = [Record(inputs, outputs, CycleTiming(0, 0, 0)) for inputs, outputs in world.records]
    engine = Engine(world.config) if snapshots else None
    snapshot = None
    for start in range(0, len(records), batch or len(records)):
        some = records[start : start + (batch or len(records))]
        session.write(some, (), snapshot)
        if engine is not None:
            for record in some:
                engine.step(record.inputs)
            snapshot = Snapshot.of(some[-1].inputs.cycle, engine.snapshot())
    session.close()
    return session.folder


def expected(records: Sequence[Record]) -> list[tuple[Inputs, RecordedOutputs]]:
    """What a reader must give back."""
    return [(record.inputs, RecordedOutputs.of(record.outputs)) for record in records]
