"""Sessions of drives beside the CAN logs of the same frames: bytes on the disk, and the processor's time for reading.

A log holds the frames with their times and nothing else; the session what replays them, and pictures. MCAP is written
as recorders of robots write it: a message of 16 bytes (as the kernel's `struct can_frame`) for each frame, a channel
for each bus and direction, chunks of its default size.
"""

import gc
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from importlib import reload
from pathlib import Path
from struct import Struct

import can
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from drivers.contract import CanFrame
from gateway.core.engine import Engine
from gateway.recording.packets import SNAPSHOT_PERIOD_NS, Record, Snapshot
from gateway.recording.process import FLUSH_NS
from gateway.types import CycleTiming, Inputs, Outputs, Twist
from replay.sessions.reader import open_session
from tests.recordings import STARTED_NS, world_writer
from tests.world import NAMES, World

RATES = (250.0, 1000.0)
COURSE = (Twist(0.5, 0.0, 0.0), Twist(0.0, 0.4, 0.0), Twist(0.0, 0.0, 0.8), Twist(0.3, 0.2, 0.3))
LEG_S = 4.0
REPEATS = 7
LOG_REPEATS = 2  # their readers take their time
SNAPSHOT_BATCHES = round(SNAPSHOT_PERIOD_NS / FLUSH_NS)
MICRO = 1e6
_FRAME = Struct("<IB3x8s")  # id with its flags, length, data


def measure() -> dict[str, float]:
    """Per robot and rate; the processor's time, the best of a few runs."""
    reload(can.io.mf4)  # which we import as if there were no asammdf
    figures: dict[str, float] = {}
    for name in NAMES:
        for rate in RATES:
            world = World(name, rate_hz=rate)
            world.start()
            for twist in COURSE:
                world.run(LEG_S, twist)
            with tempfile.TemporaryDirectory() as folder:
                found = _measured(world, Path(folder))
            figures |= {f"{key}_{name}_{rate:.0f}hz": value for key, value in found.items()}
    return figures


def recorded(world: World, folder: Path) -> Path:
    """The session of a drive as the service records it: a block every 0.4 s, a snapshot every 5 s or so."""
    records, batch = _records(world), round(FLUSH_NS / world.period_ns)
    session = world_writer(folder, world)
    engine, snapshot = Engine(world.config), None
    for number, start in enumerate(range(0, len(records), batch), start=1):
        some = records[start : start + batch]
        session.write(some, (), snapshot)
        for record in some:
            engine.step(record.inputs)
        snapshot = None if number % SNAPSHOT_BATCHES else Snapshot.of(some[-1].inputs.cycle, engine.snapshot())
    session.close()
    return session.folder


def _records(world: World) -> list[Record]:
    return [told(number, inputs, outputs) for number, (inputs, outputs) in enumerate(world.records)]


def _measured(world: World, folder: Path) -> dict[str, float]:
    session, records = recorded(world, folder), _records(world)
    frames = [(record.inputs.now_ns, frame) for record in records for frame in _frames(record)]
    logs: dict[str, tuple[Path, Callable[[Path], Iterable[object]]]] = {
        "blf": (_logged(records, folder / "drive.blf"), can.BLFReader),
        "mf4": (_logged(records, folder / "drive.mf4"), can.MF4Reader),
        "candump": (_logged(records, folder / "drive.log"), can.CanutilsLogReader),
        "mcap_lz4": (_mcap(frames, folder / "lz4.mcap", CompressionType.LZ4), _mcap_messages),
        "mcap_zstd": (_mcap(frames, folder / "zstd.mcap", CompressionType.ZSTD), _mcap_messages),
    }
    gc.freeze()  # the drive in memory is no work of the reader
    times = {"session": [spent(lambda: open_session(session).cycles()) for _ in range(REPEATS)]}
    for name, (path, reader) in logs.items():
        times[name] = [spent(partial(reader, path)) for _ in range(LOG_REPEATS)]
    gc.unfreeze()
    sizes = {name: path.stat().st_size for name, (path, _) in logs.items()}
    sizes["session"] = sum(path.stat().st_size for path in session.iterdir())
    return {
        "frames": len(frames) / len(records),
        **{f"{name}_bytes": sizes[name] / len(records) for name in times},
        **{f"{name}_read_us": min(spent) / len(records) * MICRO for name, spent in times.items()},
    }


def told(number: int, inputs: Inputs, outputs: Outputs) -> Record:
    """As a service records it: a loop keeps its time within some 100 us, every time by another amount."""
    late, work = 50_000 + number * 7919 % 90_000, 200_000 + number * 104_729 % 60_000
    return Record(inputs, outputs, CycleTiming(late, work, STARTED_NS + inputs.now_ns + number * 31 % 5000))


def _frames(record: Record) -> Sequence[CanFrame]:
    return (*record.inputs.frames, *record.outputs.frames)


def _logged(records: Sequence[Record], path: Path) -> Path:
    with can.Logger(str(path)) as log:
        for message in messages(records, named=path.suffix == ".log"):
            log.on_message_received(message)
    return path


def messages(records: Sequence[Record], *, named: bool) -> Iterator[can.Message]:
    """Their frames for a log of python-can, with channels by name or by number."""
    for record in records:
        for frame in _frames(record):
            yield can.Message(
                timestamp=(frame.received_ns or record.inputs.now_ns) * 1e-9 + STARTED_NS * 1e-9,
                arbitration_id=frame.id,
                data=None if frame.remote else frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
                channel=frame.bus if named else 0,
                is_rx=frame.received_ns is not None,
                is_fd=frame.fd,
                bitrate_switch=frame.bit_rate_switch,
            )


def _mcap(frames: Sequence[tuple[int, CanFrame]], path: Path, compression: CompressionType) -> Path:
    with path.open("wb") as file:
        log = Writer(file, compression=compression)
        log.start()
        schema = log.register_schema("can_frame", "", b"")
        channels: dict[str, int] = {}
        for now_ns, frame in frames:
            topic = f"{frame.bus}/{'tx' if frame.received_ns is None else 'rx'}"
            if topic not in channels:
                channels[topic] = log.register_channel(topic, "application/octet-stream", schema)
            at_ns = STARTED_NS + (frame.received_ns or now_ns)
            data = _FRAME.pack(frame.id | frame.extended << 31 | frame.remote << 30, len(frame.data), frame.data)
            log.add_message(channels[topic], log_time=at_ns, publish_time=at_ns, data=data)
        log.finish()  # type: ignore[no-untyped-call]
    return path


def _mcap_messages(path: Path) -> Iterator[object]:
    with path.open("rb") as file:
        yield from make_reader(file).iter_messages()


def spent(items: Callable[[], Iterable[object]]) -> float:
    """The processor's time for going through them."""
    started = time.process_time()
    for _ in items():
        pass
    return time.process_time() - started
