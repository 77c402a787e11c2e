"""The recorder as the service sees it: never in the way, and honest about what it lost."""

import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from queue import SimpleQueue

import pytest

from drivers.contract import CanFrame
from gateway.recording import child as recorder_child
from gateway.recording import process as recorder_process
from gateway.recording import recorder as recorder_module
from gateway.recording.disk import new_session, next_segment, segments
from gateway.recording.incidents import NoIncidents
from gateway.recording.packets import Record, RecorderReport
from gateway.recording.process import Taken, Unrecorded
from gateway.recording.recorder import NullRecorder, Recorder, RecorderError
from replay.sessions.reader import Session, open_session
from tests.drives import drive
from tests.recordings import STARTED_NS, expected, robot, robot_text, writer

PATIENCE_S = 20.0
STALLED = 6000  # cycles that fill the largest socket buffer


@pytest.fixture
def recorder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Recorder]:
    """A recorder that replaces a dead process at the next poll."""
    monkeypatch.setattr(recorder_module, "FIRST_BACKOFF_S", 0.0)
    made = start(tmp_path)
    yield made
    made.close(PATIENCE_S)


def start(directory: Path, **recording: object) -> Recorder:
    return Recorder(robot(directory, **recording), robot_text(), "moby.toml")


def put(recorder: Recorder, records: Sequence[Record]) -> None:
    for record in records:
        recorder.put(record.inputs, record.outputs, record.timing)


def until(recorder: Recorder, condition: Callable[[], bool]) -> None:
    """Polls at every report of the recorder process until the condition holds."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, recorder.health()
        if recorder._child is not None:
            recorder._child.wait_readable(0.05)
        recorder.poll()


def until_stopped(process: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "T":
        assert time.monotonic() < deadline
        os.sched_yield()


def pid(recorder: Recorder) -> int:
    assert recorder._child is not None
    return recorder._child.pid


def health(recorder: Recorder) -> dict[str, object]:
    """But for the incidents."""
    return {key: value for key, value in recorder.health().items() if key != "incidents"}


def settled(recorder: Recorder) -> int:
    child = recorder._child
    return 0 if child is None or child.report is None else child.report.records


def read(recorder: Recorder) -> Session:
    assert recorder.session is not None
    return open_session(recorder.session)


def test_everything_put_is_on_the_disk_after_closing(tmp_path: Path) -> None:
    records = list(drive(400))
    recorder = start(tmp_path)
    assert health(recorder) == {"session": str(recorder.session), "alive": True, "dropped": 0, "error": None}
    put(recorder, records)
    assert recorder.close()
    session = read(recorder)
    assert list(session.cycles()) == expected(records)
    assert session.complete
    assert session.gaps == ()
    assert session.config_text == robot_text()
    assert session.path.parent == tmp_path
    assert health(recorder) == {"session": str(recorder.session), "alive": False, "dropped": 0, "error": None}


def test_the_service_never_waits_for_a_stopped_process(recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "_backlog_limit", 60)
    os.kill(pid(recorder), signal.SIGSTOP)
    until_stopped(pid(recorder))
    records = list(drive(STALLED))
    started = time.process_time()
    put(recorder, records)
    recorder.poll()
    assert time.process_time() - started < 1.0
    dropped = recorder.dropped
    assert 0 < dropped < STALLED

    os.kill(pid(recorder), signal.SIGCONT)
    until(recorder, lambda: not recorder._backlog)
    later = list(drive(50, first=STALLED))
    put(recorder, later)
    assert recorder.close()
    session = read(recorder)
    kept = STALLED - dropped
    assert [(gap.first_cycle, gap.last_cycle) for gap in session.gaps] == [(kept, STALLED - 1)]
    assert session.gaps[0].reason == "the recorder could not keep up"
    assert list(session.cycles()) == expected(records[:kept] + later)
    assert len(session.problems) == 1  # the gap


def test_a_killed_process_is_replaced_and_the_gap_is_marked(recorder: Recorder) -> None:
    records = list(drive(300))
    put(recorder, records[:100])
    until(recorder, lambda: settled(recorder) == 100)
    unclosed = read(recorder)
    assert list(unclosed.cycles()) == expected(records[:100])
    assert not unclosed.complete
    first = pid(recorder)
    os.kill(first, signal.SIGSTOP)
    put(recorder, records[100:150])
    os.kill(first, signal.SIGKILL)
    until(recorder, lambda: recorder._child is None)
    error = "the recorder process ended (exit code -9)"
    assert health(recorder) == {"session": str(recorder.session), "alive": False, "dropped": 50, "error": error}
    put(recorder, records[150:])
    until(recorder, lambda: settled(recorder) == 150)
    assert pid(recorder) != first
    assert health(recorder) == {"session": str(recorder.session), "alive": True, "dropped": 50, "error": None}
    assert recorder.close()
    session = read(recorder)
    assert len(session.segments) == 2
    assert not session.complete
    assert [(gap.first_cycle, gap.last_cycle) for gap in session.gaps] == [(100, 149)]
    assert "exit code -9" in session.gaps[0].reason
    assert list(session.cycles()) == expected(records[:100] + records[150:])
    assert session.first_unproven == 100
    assert not [problem for problem in session.problems if "chain" in problem]
    assert session.segments[1].name == "segment-00002.rrd"
    assert open_session(session.segments[1]).header.chain is not None
    assert recorder.dropped == 50


PROGRAM_STARTS = {"subprocess.Popen", "os.fork", "os.forkpty", "os.exec", "os.posix_spawn", "os.system"}


class Watch:
    """Starts of programs by this process while it is `on`; an audit hook cannot be taken away again."""

    def __init__(self) -> None:
        self.on = False
        self.seen: list[str] = []
        sys.addaudithook(self._look)

    def _look(self, event: str, _arguments: object) -> None:
        if self.on and event in PROGRAM_STARTS:
            self.seen.append(event)


def test_the_service_starts_no_program_to_replace_a_dead_process(recorder: Recorder) -> None:
    """It would stop all its threads until the program is loaded: longer than its watchdog waits."""
    watch = Watch()
    first = pid(recorder)
    watch.on = True
    try:
        os.kill(first, signal.SIGKILL)
        until(recorder, lambda: recorder._child is not None and pid(recorder) != first)
        put(recorder, list(drive(20)))
        until(recorder, lambda: settled(recorder) == 20)
    finally:
        watch.on = False
    assert watch.seen == []


def test_without_the_process_that_starts_others_a_dead_one_stays_dead_and_is_told(recorder: Recorder) -> None:
    put(recorder, list(drive(10)))
    until(recorder, lambda: settled(recorder) == 10)
    os.kill(recorder._spawner.pid, signal.SIGKILL)
    first = pid(recorder)
    put(recorder, list(drive(10, first=10)))
    until(recorder, lambda: settled(recorder) == 20)  # the one that lives goes on
    assert recorder.health()["alive"]
    os.kill(first, signal.SIGKILL)
    until(recorder, lambda: "the process that starts it is gone" in (recorder.error or ""))
    assert not recorder.health()["alive"]
    assert [gap.reason for gap in read(recorder).gaps] == []
    assert not recorder.close(PATIENCE_S)


def test_recorders_outlive_the_process_that_started_them(recorder: Recorder) -> None:
    put(recorder, list(drive(10)))
    recorder._spawner.close()
    put(recorder, list(drive(10, first=10)))
    recorder.close(PATIENCE_S)
    assert read(recorder).complete


def test_closing_after_the_process_died_says_so_at_once(recorder: Recorder) -> None:
    os.kill(pid(recorder), signal.SIGKILL)
    until(recorder, lambda: recorder._child is None)
    put(recorder, list(drive(5)))
    started = time.monotonic()
    assert not recorder.close(PATIENCE_S)
    assert time.monotonic() - started < PATIENCE_S / 4


def test_a_write_error_of_the_system_costs_a_gap_not_the_recording(recorder: Recorder) -> None:
    """A real one: the kernel refuses to let the file grow, as it does when the disk is full."""
    records = list(drive(600))
    put(recorder, records[:50])
    until(recorder, lambda: settled(recorder) == 50)
    size = segments(recorder.session or Path())[0].stat().st_size
    first = pid(recorder)
    resource.prlimit(first, resource.RLIMIT_FSIZE, (size + 5000, resource.RLIM_INFINITY))
    put(recorder, records[50:350])
    until(recorder, lambda: recorder._child is not None and pid(recorder) != first)
    assert recorder.error is not None
    assert "writing thread ended" in recorder.error
    put(recorder, records[350:])
    until(recorder, lambda: settled(recorder) == 250)
    assert recorder.close()
    session = read(recorder)
    (gap,) = session.gaps
    assert gap.last_cycle == 349
    assert "exit code 75" in gap.reason
    assert list(session.cycles()) == expected(records[: gap.first_cycle] + records[350:])


STUCK_FROM_CYCLE_100 = """
import sys
from gateway.recording import process as recorder_process
from gateway.recording.segment import Segment

def write(segment, records, gaps, plain=Segment.write):
    if records and records[0].inputs.cycle >= 100:  # a call that never returns and never lets go of the interpreter
        sys.setswitchinterval(1e9)
        while True:
            pass
    plain(segment, records, gaps)

Segment.write = write
recorder_process.WRITE_LIMIT_S = 1
recorder_process.main(int(sys.argv[1]))
"""


def test_a_process_stuck_in_writing_is_replaced(recorder: Recorder, monkeypatch: pytest.MonkeyPatch) -> None:
    healthy = pid(recorder)
    monkeypatch.setattr(recorder_child, "PROGRAM", ("-c", STUCK_FROM_CYCLE_100))
    os.kill(healthy, signal.SIGKILL)
    until(recorder, lambda: recorder._child is not None and pid(recorder) != healthy)
    stuck = pid(recorder)
    monkeypatch.undo()
    records = list(drive(300))
    put(recorder, records[:100])
    until(recorder, lambda: settled(recorder) == 100)
    put(recorder, records[100:200])
    until(recorder, lambda: recorder._child is None)
    assert recorder.error == "the recorder process ended (writing was stuck)"
    until(recorder, lambda: recorder._child is not None and pid(recorder) != stuck)
    put(recorder, records[200:])
    assert recorder.close()
    session = read(recorder)
    assert [gap.reason for gap in session.gaps] == ["the recorder process ended (writing was stuck)"]
    assert list(session.cycles()) == expected(records[:100] + records[200:])


def test_closing_does_not_claim_a_footer_that_is_not_there(recorder: Recorder) -> None:
    put(recorder, list(drive(50)))
    until(recorder, lambda: settled(recorder) == 50)
    size = segments(recorder.session or Path())[0].stat().st_size
    resource.prlimit(pid(recorder), resource.RLIMIT_FSIZE, (size + 20_000, resource.RLIM_INFINITY))
    assert not recorder.close(PATIENCE_S)
    assert not read(recorder).complete


def test_a_full_disk_pauses_the_recording(tmp_path: Path) -> None:
    records = list(drive(300))
    room = [10**9]
    session = writer(tmp_path, free=lambda _: room[0])
    session.write(records[:100])
    assert session.report().error is None
    room[0] = 99
    session.write(records[100:150])
    session.write(records[150:200])
    report = session.report()
    assert report.lost == 100
    assert report.error is not None
    assert report.error.startswith("disk full: 99 bytes free")
    room[0] = 10**9
    session.write(records[200:])
    assert session.report().error is None
    session.close()
    read = open_session(session.folder)
    assert len(read.problems) == 1  # the gap
    assert len(read.segments) == 2
    (gap,) = read.gaps
    assert (gap.first_cycle, gap.last_cycle) == (100, 199)
    assert gap.reason.startswith("disk full")
    assert list(read.cycles()) == expected(records[:100] + records[200:])


def test_every_batch_is_brought_to_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the kernel alone has is lost with the power: what was asked to be on the disk holds the whole batch."""
    synced: SimpleQueue[tuple[Path, bytes]] = SimpleQueue()

    def sync(path: Path) -> None:
        synced.put((path, path.read_bytes() if path.is_file() else b""))

    records = list(drive(60))
    session = writer(tmp_path)
    monkeypatch.setattr("gateway.recording.disk.sync", sync)
    for end in (20, 40, 60):
        session.write(records[end - 20 : end])
        path, content = synced.get(timeout=PATIENCE_S)
        if end == 20:  # the file itself must be found, too
            assert synced.get(timeout=PATIENCE_S)[0] == session.folder
        (tmp_path / path.name).write_bytes(content)
        assert list(open_session(tmp_path / path.name).cycles()) == expected(records[:end])
    session.close()


def test_a_batch_waits_for_less_than_half_a_second() -> None:
    assert recorder_process.FLUSH_NS * 1e-9 + recorder_process.DRAIN_PERIOD_S < 0.45


class _Inbox:
    """Gives what it is asked for once, and ends at the second time."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.taken = 0
        self.ended = False
        self._records = records

    def take(self, limit: int) -> list[Taken]:
        self.taken += 1
        self.ended = self.taken > 1
        assert len(self._records) <= limit
        return [] if self.ended else [Taken(record, b"") for record in self._records]

    def send(self, report: object) -> None:
        """Nobody listens."""


class _Writer:
    """Notes how often the inbox had been asked when something was written."""

    def __init__(self, inbox: _Inbox) -> None:
        self.written: list[tuple[int, int]] = []
        self._inbox = inbox

    def write(self, records: Sequence[Record], *_: object) -> None:
        self.written.append((self._inbox.taken, len(records)))

    def open(self) -> None:
        """There is nothing to open."""

    def report(self) -> RecorderReport:
        return Unrecorded().report()

    def close(self, *, ended: bool) -> None:
        """There is nothing to close."""


@pytest.mark.parametrize(("cycles", "written"), [(20, [(2, 20)]), (60, [(1, 60)])])
def test_cycles_that_waited_for_a_recorder_do_not_wait_again(
    monkeypatch: pytest.MonkeyPatch, cycles: int, written: list[tuple[int, int]]
) -> None:
    """A quarter of a second of the drive at once is from a backlog; 80 ms are what comes while a batch is written."""
    monkeypatch.setattr(recorder_process, "_within_limit", nullcontext)
    inbox = _Inbox(list(drive(cycles)))
    found = _Writer(inbox)
    recorder_process.record(inbox, found, NoIncidents())  # type: ignore[arg-type]
    assert found.written == written


def test_rotation_by_age_and_a_folder_taken_away(tmp_path: Path) -> None:
    records = list(drive(80))
    session = writer(tmp_path)
    session.write(records[:20])
    session._opened_ns -= 400 * 10**9
    session.write(records[20:40])
    session.write(records[40:60])
    assert [path.name for path in segments(session.folder)] == ["segment-00001.rrd", "segment-00002.rrd"]
    shutil.rmtree(session.folder)
    session.write(records[60:70])
    session.write(records[70:])
    session.close()
    read = open_session(session.folder)
    assert list(read.cycles()) == expected(records[60:])
    assert "segments 1 to 2 are missing" in read.problems
    assert read.header.config_text == robot_text()


def test_no_room_at_the_start_does_not_stop_the_robot(tmp_path: Path) -> None:
    recorder = start(tmp_path, min_free=10**13)
    assert recorder.session is not None
    assert recorder.error is not None
    assert recorder.error.startswith("disk full")
    put(recorder, list(drive(10)))
    assert recorder.close()
    assert recorder.dropped == 10


def test_what_cannot_be_recorded_costs_one_cycle_each(recorder: Recorder) -> None:
    """A packet that is too long, an integer that fits no column, a text that is none."""
    records = list(drive(40))
    many = tuple(CanFrame("can0", 1, bytes(8)) for _ in range(60_000))
    wild = tuple(command._replace(sequence=2**63) for command in records[0].inputs.commands)
    for cycle, inputs in (
        (5, records[5].inputs._replace(frames=many)),
        (17, records[17].inputs._replace(commands=wild)),
        (30, records[30].inputs._replace(frames=(CanFrame("\ud800", 1, b""),))),
    ):
        records[cycle] = Record(inputs, records[cycle].outputs, records[cycle].timing)
    put(recorder, records)
    assert recorder.dropped == 2
    assert recorder.close()
    assert recorder.dropped == 3
    gaps = read(recorder).gaps
    assert [(gap.first_cycle, gap.last_cycle) for gap in gaps] == [(5, 5), (17, 17), (30, 30)]
    assert all(gap.reason.startswith("not recordable: ") for gap in gaps)


def test_signals_and_descriptors_are_not_inherited(recorder: Recorder) -> None:
    inner, outer = os.pipe()
    os.set_inheritable(inner, True)
    os.kill(pid(recorder), signal.SIGKILL)
    until(recorder, lambda: recorder._child is None)
    until(recorder, lambda: settled(recorder) == 0 and recorder.error is None)
    held = {str(path.readlink()) for path in Path(f"/proc/{pid(recorder)}/fd").iterdir()}
    assert str(Path(f"/proc/self/fd/{inner}").readlink()) not in held
    os.close(inner)
    os.close(outer)
    os.kill(pid(recorder), signal.SIGTERM)
    os.kill(pid(recorder), signal.SIGINT)
    put(recorder, list(drive(10)))
    assert recorder.close()
    assert len(list(read(recorder).cycles())) == 10


_DOOMED_SERVICE = """
import os, signal, sys
from pathlib import Path
from tests.gateway.test_recorder import pid, put, start
from tests.drives import drive
recorder = start(Path(sys.argv[1]))
records = list(drive(300))
put(recorder, records[:100])
assert recorder._child.wait_readable(20.0)  # a report that will never be read
put(recorder, records[100:])
print(pid(recorder), recorder.session, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_service_leaves_every_cycle_and_an_open_end(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _DOOMED_SERVICE, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    process, folder = done.stdout.split()
    wait_for_end(int(process))
    session = open_session(Path(folder))
    assert list(session.cycles()) == expected(list(drive(300)))
    assert session.problems == ("the session was not ended in order: its last cycles may be missing",)


def wait_for_end(process: int) -> None:
    """Of a process that is nobody's child any more."""
    try:
        descriptor = os.pidfd_open(process)
    except ProcessLookupError:
        return
    ready, _, _ = select.select([descriptor], [], [], PATIENCE_S)
    os.close(descriptor)
    assert ready


def test_rerun_switched_off_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(RecorderError, match="RERUN=off"):
        start(tmp_path)


def test_a_directory_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecorderError) as caught:
        start(tmp_path / "file")
    message = str(caught.value)
    assert message.startswith(f"recording.directory = '{tmp_path}/file': ")
    assert message.endswith("; give another directory, or recording.enabled = false")
    assert "Errno" not in message


def test_the_service_does_not_import_rerun() -> None:
    code = "import sys, gateway.recording.recorder; print({'rerun', 'rerun_bindings', 'pyarrow'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_null_recorder() -> None:
    nothing = NullRecorder()
    put(nothing, list(drive(1)))  # type: ignore[arg-type]
    nothing.poll()
    assert nothing.close()
    assert nothing.health() == {"session": None, "alive": False, "dropped": 0, "error": None, "incidents": None}


def test_names_of_sessions_and_segments(tmp_path: Path) -> None:
    first, second = (new_session(tmp_path, "moby", STARTED_NS) for _ in range(2))
    assert (first.name, second.name) == ("moby-20260921T141320Z", "moby-20260921T141320Z-2")
    assert next_segment(first) == 1
    for number in (2, 99_999, 100_000):
        (first / f"segment-{number:05d}.rrd").touch()
    assert [path.name for path in segments(first)][-1] == "segment-100000.rrd"
    assert next_segment(first) == 100_001


def test_a_recorder_slow_to_start_costs_neither_the_start_nor_a_cycle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "READY_TIMEOUT_S", 0.0)
    records = list(drive(400))
    recorder = start(tmp_path)
    assert recorder.session is None
    assert recorder.error is not None
    assert "not ready" in recorder.error
    put(recorder, records)
    until(recorder, lambda: recorder.session is not None)
    assert recorder.close(PATIENCE_S)
    assert recorder.health()["error"] is None
    assert recorder.dropped == 0
    assert list(read(recorder).cycles()) == expected(records)
