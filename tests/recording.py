"""Writes a drive of tests.world to disk, as the recorder process would."""

from pathlib import Path

from gateway.record import Hello, Record
from gateway.recorder_writer import SessionWriter
from gateway.types import CycleTiming
from tests.world import World


def record(world: World, directory: Path) -> Path:
    """The session folder of this drive."""
    recording = world.config.recording.model_copy(update={"directory": str(directory), "min_free": 1_000_000})
    config = world.config.model_copy(update={"recording": recording})
    writer = SessionWriter(
        config,
        Hello(
            config_json=config.model_dump_json(),
            config_text=world.text,
            config_origin=world.config.robot.name,
            folder=None,
            started_wall_ns=1_790_000_000_000_000_000,
            wall_minus_mono_ns=0,
        ),
    )
    writer.open()
    timing = CycleTiming(0, 0, 0)
    writer.write([Record(inputs, outputs, timing) for inputs, outputs in world.records])
    writer.close()
    return writer.folder
