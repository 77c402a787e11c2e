"""Sessions of real drives beside the CAN logs of the same frames: bytes on the disk, and how fast a session is read."""

import gc
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import can

from drivers.contract import CanFrame
from gateway.core.engine import Engine
from gateway.recording.packets import Record, Snapshot
from gateway.types import CycleTiming, Inputs, Outputs, Twist
from replay.sessions.reader import open_session
from tests.recordings import STARTED_NS, world_writer
from tests.world import NAMES, World

RATES = (250.0, 1000.0)
COURSE = (Twist(0.5, 0.0, 0.0), Twist(0.0, 0.4, 0.0), Twist(0.0, 0.0, 0.8), Twist(0.3, 0.2, 0.3))
LEG_S = 4.0
REPEATS = 7
SNAPSHOT_SECONDS = 5  # as the service takes them; a batch is a second
MICRO = 1e6


def measure() -> dict[str, float]:
    """Per robot and rate; the processor's time, the best of a few runs."""
    figures: dict[str, float] = {}
    for name in NAMES:
        for rate in RATES:
            world = World(name, rate_hz=rate)
            world.start()
            for twist in COURSE:
                world.run(LEG_S, twist)
            with tempfile.TemporaryDirectory() as folder:
                found = _measured(world, round(rate), Path(folder))
            figures |= {f"{key}_{name}_{rate:.0f}hz": value for key, value in found.items()}
    return figures


def _measured(world: World, batch: int, folder: Path) -> dict[str, float]:
    records = [_record(number, inputs, outputs) for number, (inputs, outputs) in enumerate(world.records)]
    session = world_writer(folder, world)
    engine, snapshot = Engine(world.config), None
    for number, start in enumerate(range(0, len(records), batch), start=1):
        some = records[start : start + batch]
        session.write(some, (), snapshot)
        for record in some:
            engine.step(record.inputs)
        snapshot = None if number % SNAPSHOT_SECONDS else Snapshot.of(some[-1].inputs.cycle, engine.snapshot())
    session.close()
    frames = [(record.inputs.now_ns, frame) for record in records for frame in _frames(record)]
    sizes = {
        "session_bytes": sum(path.stat().st_size for path in session.folder.iterdir()),
        "blf_bytes": _logged(frames, folder / "drive.blf"),
        "candump_bytes": _logged(frames, folder / "drive.log"),
    }
    gc.freeze()  # the drive in memory is no work of the reader
    times = [_read_time(session.folder) for _ in range(REPEATS)]
    gc.unfreeze()
    return {
        **{name: size / len(records) for name, size in sizes.items()},
        "frames": len(frames) / len(records),
        "session_read_us": min(times) / len(records) * MICRO,
    }


def _record(number: int, inputs: Inputs, outputs: Outputs) -> Record:
    """As a service records it: a loop keeps its time within some 100 us, every time by another amount."""
    late, work = 50_000 + number * 7919 % 90_000, 200_000 + number * 104_729 % 60_000
    return Record(inputs, outputs, CycleTiming(late, work, STARTED_NS + inputs.now_ns + number * 31 % 5000))


def _frames(record: Record) -> Sequence[CanFrame]:
    return (*record.inputs.frames, *record.outputs.frames)


def _logged(frames: Sequence[tuple[int, CanFrame]], path: Path) -> int:
    with can.Logger(str(path)) as log:
        for now_ns, frame in frames:
            log.on_message_received(
                can.Message(
                    timestamp=(frame.received_ns or now_ns) * 1e-9 + STARTED_NS * 1e-9,
                    arbitration_id=frame.id,
                    data=None if frame.remote else frame.data,
                    is_extended_id=frame.extended,
                    is_remote_frame=frame.remote,
                    channel=0 if path.suffix == ".blf" else frame.bus,
                    is_rx=frame.received_ns is not None,
                    is_fd=frame.fd,
                    bitrate_switch=frame.bit_rate_switch,
                )
            )
    return path.stat().st_size


def _read_time(folder: Path) -> float:
    started = time.process_time()
    for _ in open_session(folder).cycles():
        pass
    return time.process_time() - started
