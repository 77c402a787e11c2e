"""`python -m tests.bench.hour [--minutes N] [--robot NAME]`: a long drive at 1 kHz verified, and its frames parsed.

The drive is generated, the course of `tests.bench.sessions` again and again; its segments are as large as those of five
minutes. The logs that python-can parses hold the first tenth of its frames, in the same run, on the same machine. Each
verification is a process of its own, so that the memory it needs can be told: of the whole, and of the first tenth.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import can

from gateway.build import ROOT
from gateway.recording.packets import Record, Snapshot
from gateway.recording.process import FLUSH_NS
from replay.sessions.reader import open_session
from tests.bench.sessions import COURSE, LEG_S, MICRO, RATES, SNAPSHOT_BATCHES, messages, spent, told
from tests.recordings import world_writer
from tests.world import World

RATE_HZ = max(RATES)
SEGMENT_BYTES = 25_000_000
MEGA = 1024.0  # of the kilobytes that the kernel counts in


class Verified(NamedTuple):
    """One verification: cycles, processor's time, time that went by, most memory."""

    cycles: int
    processor_s: float
    seconds: float
    megabytes: float


def main() -> int:
    """Prints what was found; exit 1 if a session was not found identical."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--robot", default="moby")
    wanted = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="drivegate-hour-") as name:
        folder = Path(name)
        began = time.perf_counter()
        whole, part = _generated(folder, wanted.robot, wanted.minutes * 60.0)
        print(f"generated {wanted.minutes:g} min at {RATE_HZ:g} Hz in {time.perf_counter() - began:.0f} s", flush=True)
        cycles = _parsed(folder, part)
        for path, words in ((part, "first tenth"), (whole, "whole")):
            found = _verified(path)
            each_us, times = found.processor_s / found.cycles * MICRO, found.cycles / RATE_HZ / found.seconds
            told_us = f"{found.cycles} cycles, {each_us:.1f} us per cycle"
            print(f"verify, {words}: {told_us}, {times:.1f} x real time, {found.megabytes:.0f} MB", flush=True)
        size = sum(file.stat().st_size for file in whole.iterdir())
        print(f"{size / 1e6:.0f} MB on the disk, {size / (cycles * 10):.0f} bytes per cycle")
    return 0


def _generated(folder: Path, robot: str, seconds: float) -> tuple[Path, Path]:
    """Sessions of the drive and of its first tenth, and logs of the frames of that."""
    world = World(robot, rate_hz=RATE_HZ)
    size = {"segment_bytes": SEGMENT_BYTES}
    whole, part = (world_writer(folder / name, world, **size) for name in ("whole", "part"))
    with ExitStack() as stack:
        logs = {kind: stack.enter_context(can.Logger(str(folder / f"drive.{kind}"))) for kind in ("log", "blf")}
        for records, snapshot in _batches(world, seconds):
            whole.write(records, (), snapshot)
            if records[-1].inputs.cycle > seconds * RATE_HZ / 10.0:
                continue
            part.write(records, (), snapshot)
            for kind, log in logs.items():
                for message in messages(records, named=kind == "log"):
                    log.on_message_received(message)
    whole.close()
    part.close()
    return whole.folder, part.folder


def _batches(world: World, seconds: float) -> Iterator[tuple[list[Record], Snapshot | None]]:
    """As the service would hand them over; nothing of it stays in memory."""
    number, snapshot = 0, None
    world.start()
    for batch in range(round(seconds * 1e9 / FLUSH_NS)):
        leg = int(batch * FLUSH_NS * 1e-9 / LEG_S) % len(COURSE)
        world.run(FLUSH_NS * 1e-9, COURSE[leg])
        records = [told(number + place, *one) for place, one in enumerate(world.records)]
        world.records.clear()
        number += len(records)
        yield records, snapshot
        due = batch % SNAPSHOT_BATCHES == SNAPSHOT_BATCHES - 1
        snapshot = Snapshot.of(records[-1].inputs.cycle, world.engine.snapshot()) if due else None


def _parsed(folder: Path, session: Path) -> int:
    """What it costs to read the frames; the cycles of the session."""
    cycles = open_session(session).cycle_count
    readers = {
        "DriveGate, reading": lambda: open_session(session).cycles(),
        "python-can, candump": lambda: can.CanutilsLogReader(folder / "drive.log"),
        "python-can, BLF": lambda: can.BLFReader(folder / "drive.blf"),
    }
    for name, reader in readers.items():
        print(f"{name:24} {spent(reader) / cycles * MICRO:7.1f} us per cycle", flush=True)
    return cycles


def _verified(session: Path) -> Verified:
    """In a process of its own; it must be identical."""
    command = [sys.executable, "-m", "gateway", "replay", "verify", str(session), "--jobs", "1", "--json"]
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert process.stdout is not None
    answer = json.loads(process.stdout.read())
    _, _, used = os.wait4(process.pid, 0)
    assert answer["identical"], answer
    seconds = time.perf_counter() - began
    return Verified(answer["cycles"], used.ru_utime + used.ru_stime, seconds, used.ru_maxrss / MEGA)


if __name__ == "__main__":
    sys.exit(main())
