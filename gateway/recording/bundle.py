"""The process that writes one incident: its cycles from a state of the core on, in one file that verifies on its own.

How this works
--------------
Everything comes in one file in memory: pieces of the ring, the causes, and what the header of a session says. They are
run through the core once for the verdict, which is in the header, and once more written, as a session of one segment.
The file has another name until it is closed and on the disk; then its digest is noted beside it, for `sha256sum`.
Room is made among the incidents of this robot (`gateway.recording.disk.expendable`). One process at a time writes in
the folder; a lock, which the kernel frees, tells them apart from what one that died has left. It is the least of all
that runs here: it gets what processor time is left over, and is the first to go when memory is short.
"""

import contextlib
import fcntl
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple, NoReturn

import msgspec
import rerun as rr

from gateway.config import RobotConfig
from gateway.recording.blueprint import blueprint
from gateway.recording.disk import (
    FOLDER_MODE,
    INCIDENTS,
    UNFINISHED,
    add_sum,
    expendable,
    forget_sums,
    free_bytes,
    incident_file,
    incident_files,
    make_folder,
    new_incident,
    sync,
)
from gateway.recording.failures import RecordingOffError, WriterDeadError
from gateway.recording.header import header
from gateway.recording.incidents import Order, Written
from gateway.recording.judge import judgement
from gateway.recording.packets import Gap, Packet, Record, Snapshot, encode
from gateway.recording.ring import packets
from gateway.recording.schema import Header
from gateway.recording.segment import Segment
from gateway.recording.views import Views

logger = logging.getLogger(__name__)

BATCH_NS = 1_000_000_000
NICE = 19
STUCK_S = 60  # without any step, of some that take milliseconds on a computer at ease
FIRST_TO_GO = "1000"  # of oom_score_adj
UNKNOWN = "the state of the core behind them was not known to the recorder"
_ENDED = 75  # EX_TEMPFAIL of sysexits.h
_BAD_VALUE = (OverflowError, TypeError, ValueError)


Alive = Callable[[], None]


class IncidentError(Exception):
    """An incident that is not kept; the text says why."""


class _Batch(NamedTuple):
    records: Sequence[Record]
    gaps: Sequence[Gap]
    snapshot: Snapshot | None


def kept(order: Order, alive: Alive = lambda: None) -> Written:
    """Write it; `alive` is called at every step.

    Raises IncidentError, OSError, RecordingOffError, WriterDeadError.
    """
    config = RobotConfig.model_validate_json(order.hello.config_json)
    first = next((packet for packet in _packets(order) if isinstance(packet, Record)), None)
    if first is None:
        raise IncidentError("no cycle of it was kept")
    judged = judgement(config, _packets(order, alive))
    incident = msgspec.structs.replace(order.incident, judgement=judged)
    folder = Path(config.recording.directory) / INCIDENTS
    if not folder.exists():
        with contextlib.suppress(FileExistsError):  # of another robot's, at the same moment
            folder.parent.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
            make_folder(folder)
    with _alone(folder):
        clear(folder, config.robot.name)
        first_cause = incident.causes[0]
        name = new_incident(folder, config.robot.name, first_cause.wall_ns, first_cause.name)
        told = msgspec.structs.replace(
            header(order.hello, session=name, robot=config.robot.name),
            started_wall_ns=first.timing.wall_ns,
            first_cycle=_first_cycle(order),
            cut_from=order.session,
            incident=incident,
        )
        path = _stored(folder / name, config, told, _packets(order, alive))
    return Written(str(path.absolute()), judged.verdict, None)


def _stored(path: Path, config: RobotConfig, told: Header, found: Iterable[Packet]) -> Path:
    """`path`: without suffix."""
    folder, unfinished = path.parent, path.with_name(f"{path.name}{UNFINISHED}")
    finished = path.with_name(f"{path.name}.rrd")
    try:
        _make_room(finished, config, 0)
        digest = _write(unfinished, config, told, found)
        sync(unfinished)
        _make_room(finished, config, unfinished.stat().st_size)
        unfinished.rename(finished)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    try:
        add_sum(finished, digest)
    except OSError as error:  # it is whole, and has a seal of its own
        logger.warning("its digest is not noted: %s", error)
    sync(folder)
    sync(folder.parent)
    return finished


def _write(path: Path, config: RobotConfig, told: Header, found: Iterable[Packet]) -> str:
    """SHA-256 of the file, hex."""
    rr.set_strict_mode(True)  # a mistake in a column is an error, not a warning and a hole
    segment = Segment(path, header=told, views=Views(config), blueprint=blueprint(config))
    last = told.first_cycle
    for batch in _batches(found):
        if batch.snapshot is not None:
            segment.keep(batch.snapshot)
        _write_batch(segment, batch.records, batch.gaps)
        segment.flush()
        last = batch.records[-1].inputs.cycle
    return segment.close(first_segment=1, final=True, last_cycle=last)


def _write_batch(segment: Segment, records: Sequence[Record], gaps: Sequence[Gap]) -> None:
    """One with a value that no column holds must not cost its neighbours: halve until it stands alone."""
    try:
        segment.write(records, gaps)
    except _BAD_VALUE as error:
        if len(records) == 1:
            cycle = records[0].inputs.cycle
            segment.write((), [*gaps, Gap(cycle, cycle, f"not recordable: {error}")])
            return
        half = len(records) // 2
        _write_batch(segment, records[:half], gaps)
        _write_batch(segment, records[half:], ())


def _packets(order: Order, alive: Alive = lambda: None) -> Iterator[Packet]:
    """Up to its last cycle; in front of all is said what is missing, if no state of the core leads to the first."""
    begins = True
    for packet in chain.from_iterable(_unpacked(order, alive)):
        if isinstance(packet, Record) and packet.inputs.now_ns > order.end_ns:
            return
        if begins and isinstance(packet, Record) and packet.inputs.cycle > 0:
            yield Gap(0, packet.inputs.cycle - 1, UNKNOWN)
        begins = begins and isinstance(packet, Gap)
        yield packet


def _unpacked(order: Order, alive: Alive) -> Iterator[Sequence[Packet]]:
    for piece in order.pieces:
        alive()
        yield packets(piece)


def _first_cycle(order: Order) -> int:
    """From which on it is meant to be whole: behind the state with which it begins, or from the start of the drive."""
    begins = next(packet for packet in _packets(order) if not isinstance(packet, Gap))
    return begins.cycle + 1 if isinstance(begins, Snapshot) else 0


def _batches(found: Iterable[Packet]) -> Iterator[_Batch]:
    """Cycles in batches, each with what is in front of it: a gap, the state of the core."""
    records: list[Record] = []
    gaps: list[Gap] = []
    snapshot: Snapshot | None = None
    for packet in found:
        full = bool(records) and (
            not isinstance(packet, Record) or packet.inputs.now_ns - records[0].inputs.now_ns >= BATCH_NS
        )
        if full:
            yield _Batch(records, gaps, snapshot)
            records, gaps, snapshot = [], [], None
        if isinstance(packet, Record):
            records.append(packet)
        elif isinstance(packet, Gap):
            gaps.append(packet)
        elif isinstance(packet, Snapshot):
            snapshot = packet
    if records:
        yield _Batch(records, gaps, snapshot)


# the folder


def clear(folder: Path, robot: str) -> None:
    """Take away what a process that died has left."""
    for path in folder.glob(f"{robot}-*{UNFINISHED}"):
        path.unlink(missing_ok=True)


def _make_room(coming: Path, config: RobotConfig, size: int) -> None:
    """Delete others until `size` bytes fit the budget and the disk has room. Raises IncidentError, OSError."""
    folder, robot = coming.parent, config.robot.name
    budget, min_free = config.recording.incidents.budget, config.recording.min_free
    if size > budget:
        raise IncidentError(f"it has {size} bytes, recording.incidents.budget is {budget}")
    named = incident_file(coming, robot)
    assert named is not None
    found = [(one.path, one.path.lstat().st_size) for one in expendable(incident_files(folder, robot), named)]
    excess = max(sum(taken for _, taken in found) + size - budget, min_free - free_bytes(folder))
    if excess > sum(taken for _, taken in found):  # nothing is deleted in vain
        free = free_bytes(folder)
        raise IncidentError(f"disk full: {free} bytes free at {folder}, recording.min_free is {min_free}")
    gone: list[str] = []
    for path, taken in found:
        if excess <= 0:
            break
        path.unlink()
        gone.append(path.name)
        excess -= taken
        logger.warning("deleted %s to make room", path)
    try:
        forget_sums(folder, gone)
    except OSError as error:  # the one that comes is worth more
        logger.warning("digests of what was deleted are still noted: %s", error)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Wait until no other process writes here; where the file system knows no locks it goes on without."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


# the process


def main(given: int, answer: int) -> int:
    """Exit code: 0 when it is kept."""
    logging.basicConfig(level=logging.INFO, format="incident: %(message)s")
    _step_back()
    with os.fdopen(given, "rb") as file:
        order = msgspec.msgpack.decode(file.read(), type=Order)
    try:
        written = kept(order, _live_on)
    except (IncidentError, RecordingOffError, WriterDeadError) as error:
        written = Written(None, None, str(error))
    except OSError as error:
        known = error.filename and error.strerror
        written = Written(None, None, f"{error.filename}: {error.strerror}" if known else str(error))
    if written.error is not None:
        logger.warning("not kept: %s", written.error)
    with contextlib.suppress(BrokenPipeError):  # the recorder may have ended before
        os.write(answer, encode(written))
    return 0 if written.error is None else _ENDED


def _step_back() -> None:
    """Behind everything else that runs, and ready to be ended."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    _live_on()
    with contextlib.suppress(OSError):
        os.nice(NICE)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_GO, encoding="ascii")


def _live_on() -> None:
    """The kernel ends this process if this is not called again in time: Rerun may block for ever on a full disk.

    Nothing written in Python could be relied on to notice.
    """
    signal.alarm(STUCK_S)


def _leave(code: int) -> NoReturn:
    """Not sys.exit: after a dead writing thread the interpreter's orderly end waits for it, for ever."""
    logging.shutdown()
    os._exit(code)


if __name__ == "__main__":
    _leave(main(int(sys.argv[1]), int(sys.argv[2])))
