"""Recordings that processes were killed over, that were cut, and of which bits were flipped: what is lost of them.

The kills are of real processes at real, random moments; the figures are times of the service's own clock.
"""

import os
import random
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from struct import Struct
from typing import NamedTuple

from gateway.recording.packets import Record
from gateway.recording.recorder import Recorder
from replay.sessions.reader import Session, SessionError, open_session
from tests.drives import drive
from tests.recordings import expected, robot, robot_text, writer

RATE = 250.0
PATIENCE_S = 20.0
LONGEST_S = 1.5  # that a process is left alone before it is killed: some flush intervals
FLUSHED = 100  # cycles of a batch at RATE
LAST = Struct("<qq")  # cycle and time


class Loss(NamedTuple):
    """Of one kill or cut. `seconds`: cycles that were handed over and are not there. `refused`: why nothing is."""

    seconds: float
    refused: str | None = None


class Flips(NamedTuple):
    """`unnoticed`: called complete all the same; `altered`: a cycle read otherwise than it was, and not named."""

    flips: int
    unnoticed: int
    altered: int
    refused: int
    lost_s: tuple[float, ...]


def kill_recorders(directory: Path, kills: int, seed: int) -> tuple[Session, list[Loss]]:
    """One service whose recorder is killed again and again."""
    generator = random.Random(seed)
    recorder = Recorder(robot(directory), robot_text())
    cycles = drive_in_time()
    for _ in range(kills):
        recorder._retry_at = 0.0
        _put_until(recorder, cycles, lambda: recorder._child is not None and recorder._child.report is not None)
        end = time.monotonic() + generator.uniform(0.0, LONGEST_S)
        _put_until(recorder, cycles, lambda end=end: time.monotonic() >= end)  # type: ignore[misc]
        assert recorder._child is not None
        os.kill(recorder._child.pid, signal.SIGKILL)
        _put_until(recorder, cycles, lambda: recorder._child is None)
    recorder._retry_at = 0.0
    _put_until(recorder, cycles, lambda: recorder._child is not None and not recorder._backlog)
    assert recorder.close(PATIENCE_S)
    assert recorder.session is not None
    session = open_session(recorder.session)
    losses = [Loss((gap.last_cycle - gap.first_cycle + 1) / RATE) for gap in session.gaps]
    return session, losses + [Loss(0.0)] * (kills - len(losses))


def kill_services(directory: Path, kills: int, seed: int, *, recorder_too: bool) -> Iterator[Loss]:
    """A service each time, with `recorder_too` its recorder at the same moment."""
    generator = random.Random(seed)
    for number in range(kills):
        folder = directory / f"service-{number}"
        folder.mkdir()
        yield _killed(folder, generator.uniform(0.0, LONGEST_S), recorder_too=recorder_too)


def _killed(folder: Path, after_s: float, *, recorder_too: bool) -> Loss:
    shared = folder / "last"
    shared.write_bytes(bytes(LAST.size))
    command = [sys.executable, "-c", "from tests.damage import serve; serve()", str(folder), str(shared)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as service:
        assert service.stdout is not None
        told = service.stdout.readline().split()
        assert len(told) == 2, "the service did not start"
        ended = os.pidfd_open(int(told[0]))
        select.select([], [], [], after_s)  # the moment is random: nothing is waited for
        if recorder_too:
            signal.pidfd_send_signal(ended, signal.SIGKILL)
        service.kill()
    ready, _, _ = select.select([ended], [], [], PATIENCE_S)
    os.close(ended)
    assert ready, "the recorder lives on"
    _, last_ns = LAST.unpack(shared.read_bytes())
    try:
        session = open_session(Path(told[1]))
    except SessionError as error:
        return Loss(after_s, str(error))
    found = [inputs for inputs, _ in session.cycles()]
    assert [inputs.cycle for inputs in found] == list(range(len(found)))
    assert not session.complete
    return Loss(max(last_ns - found[-1].now_ns, 0) * 1e-9 if found else after_s)


def serve() -> None:
    """A service without motors, until it is killed: arguments are the directory and a file for its last cycle."""
    directory, shared = map(Path, sys.argv[1:])
    recorder = Recorder(robot(directory), robot_text())
    assert recorder._child is not None
    with shared.open("r+b", buffering=0) as last:
        for record in drive_in_time():
            recorder.put(record.inputs, record.outputs, record.timing)
            os.pwrite(last.fileno(), LAST.pack(record.inputs.cycle, record.inputs.now_ns), 0)
            if record.inputs.cycle == 0:
                sys.stdout.write(f"{recorder._child.pid} {recorder.session}\n")
                sys.stdout.flush()
            if record.inputs.cycle % 50 == 0:
                recorder.poll()


def drive_in_time() -> Iterator[Record]:
    """A cycle whenever it is due, told at the time it is."""
    due = time.monotonic()
    for record in drive(10**7, rate=RATE):
        time.sleep(max(due - time.monotonic(), 0.0))
        due = max(due + 1 / RATE, time.monotonic() - 0.1)
        inputs = record.inputs._replace(now_ns=time.monotonic_ns())
        yield Record(inputs, record.outputs, record.timing)


def _put_until(recorder: Recorder, cycles: Iterator[Record], done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    for record in cycles:
        recorder.put(record.inputs, record.outputs, record.timing)
        recorder.poll()
        if done():
            return
        assert time.monotonic() < deadline, recorder.health()


def recorded(directory: Path, cycles: int) -> tuple[Path, list[Record]]:
    """A closed session of one segment, of batches as the recorder writes them."""
    records = list(drive(cycles, rate=RATE))
    session = writer(directory)
    for start in range(0, cycles, FLUSHED):
        session.write(records[start : start + FLUSHED])
    session.close()
    (path,) = session.folder.glob("*.rrd")
    return path, records


def cut(path: Path, records: Sequence[Record], cuts: int, seed: int) -> Iterator[Loss]:
    """A segment that ends at a random byte, as if that were all that had come to the disk.

    What is there must be the truth from the beginning on. Lost is what had been handed over when that byte was written:
    up to the end of the batch that is cut.
    """
    whole, data = expected(records), path.read_bytes()
    ends = _ends_of_batches(path, data)
    generator = random.Random(seed)
    for _ in range(cuts):
        place = generator.randrange(len(data))
        path.write_bytes(data[:place])
        kept = FLUSHED * sum(end <= place for end in ends)
        written = min(kept + FLUSHED, len(records)) if place > ends[0] - (ends[1] - ends[0]) else 0
        try:
            session = open_session(path)
        except SessionError as error:
            assert not kept, "there are whole batches in it"
            yield Loss(written / RATE, str(error))
            continue
        found = list(session.cycles())
        assert found == whole[:kept], "a whole batch is lost"
        assert not session.complete
        yield Loss((written - kept) / RATE)
    path.write_bytes(data)


def _ends_of_batches(path: Path, data: bytes) -> list[int]:
    """The bytes with which one more batch is there, by halving."""
    ends: list[int] = []
    probe = path.with_name("probe.rrd")
    total = open_session(path).cycle_count
    for wanted in range(FLUSHED, total + FLUSHED, FLUSHED):
        low, high = ends[-1] if ends else 0, len(data)
        while low < high:
            middle = (low + high) // 2
            probe.write_bytes(data[:middle])
            low, high = (low, middle) if _count(probe) >= min(wanted, total) else (middle + 1, high)
        ends.append(low)
    probe.unlink()
    return ends


def _count(path: Path) -> int:
    try:
        return open_session(path).cycle_count
    except SessionError:
        return 0


def flip(path: Path, records: Sequence[Record], flips: int, seed: int) -> Flips:
    """One random bit of the file at a time, from its first byte to its last."""
    whole, data = expected(records), path.read_bytes()
    generator = random.Random(seed)
    unnoticed = altered = refused = 0
    lost: list[float] = []
    for _ in range(flips):
        spoilt = bytearray(data)
        spoilt[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
        path.write_bytes(spoilt)
        try:
            session = open_session(path)
            found = list(session.cycles())
        except SessionError:
            refused += 1
            continue
        unnoticed += session.complete
        altered += any(pair != whole[pair[0].cycle] for pair in found)
        lost.append((len(whole) - len(found)) / RATE)
    path.write_bytes(data)
    return Flips(flips, unnoticed, altered, refused, tuple(lost))
