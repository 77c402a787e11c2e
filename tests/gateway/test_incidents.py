"""What is an incident, what is kept in memory for it, and that nobody ever waits for one."""

import errno
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import RobotConfig
from gateway.core.health import FaultKind
from gateway.recording import bundle
from gateway.recording import incidents as incidents_module
from gateway.recording.bundle import IncidentError, clear, kept
from gateway.recording.disk import INCIDENTS, SUMS, IncidentFile, expendable, incidents, new_incident
from gateway.recording.incident import MOST_CAUSES, Cause, causes
from gateway.recording.incidents import MOST_WINDOWS, STUCK, Incidents, Order, WritingProcess, Written
from gateway.recording.packets import Gap, IncidentReport, Packet, Record, Snapshot, encode
from gateway.recording.ring import LATE_NS, PIECE_BYTES, Ring, packets
from gateway.types import (
    BusEvent,
    BusEventKind,
    CycleTiming,
    Event,
    Inputs,
    Level,
    Mode,
    Request,
    RequestKind,
)
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.drives import drive
from tests.incidents import Given, MarkedWorld, orders, short, with_budget, with_snapshots
from tests.recordings import STARTED_NS, hello, robot

MS = 1_000_000
PATIENCE_S = 60.0


def cycle(number: int, *events: Event, requests: tuple[Request, ...] = (), now_ns: int | None = None) -> Record:
    plain = next(drive(1))
    inputs = Inputs(number, 1_000_000_000 + number * 10 * MS if now_ns is None else now_ns, requests=requests)
    return Record(inputs, plain.outputs._replace(events=events), CycleTiming(0, 0, STARTED_NS + inputs.now_ns))


# what is one


@pytest.mark.parametrize(
    ("event", "counts"),
    [
        (Event(Level.ERROR, "mode_fault", "drive -> fault: silent"), True),
        (Event(Level.ERROR, "mode_estop", "drive -> estop"), True),
        (Event(Level.WARNING, "mode_degraded", "drive -> degraded"), True),
        (Event(Level.ERROR, "fault_silent", "left: silent"), True),
        (Event(Level.ERROR, "bus_down", "can0: gone"), True),
        (Event(Level.INFO, "mode_idle", "stopping -> idle"), False),
        (Event(Level.INFO, "mode_drive", "starting -> drive"), False),
        (Event(Level.INFO, "mode_stopping", "drive -> stopping"), False),
        (Event(Level.WARNING, "refused_stale", "teleop: late"), False),
        (Event(Level.WARNING, "overrun", "late"), False),
        (Event(Level.WARNING, "slip", "a wheel slips"), False),
        (Event(Level.INFO, "mark", "held back by the throttle or not, the request is what counts"), False),
    ],
)
def test_what_stopped_the_robot_is_an_incident_and_its_daily_work_is_none(event: Event, counts: bool) -> None:
    found = list(causes(cycle(7, event)))
    assert [(one.code, one.text) for one in found] == ([(event.code, event.text)] if counts else [])
    assert list(causes(cycle(0, event))) == []  # a stop that was kept over a restart is no news


def test_every_mark_counts_also_one_whose_event_is_held_back() -> None:
    marks = tuple(Request(RequestKind.MARK, number, 0, text=f"mark {number}") for number in (1, 2))
    found = list(causes(cycle(7, requests=(*marks, Request(RequestKind.RESET, 3, 0)))))
    assert [(one.code, one.text) for one in found] == [("mark", "mark 1"), ("mark", "mark 2")]


def test_modes_of_a_real_drive() -> None:
    """Into ESTOP, and not each time that it starts and rests."""
    world = MarkedWorld("omni4", ())
    world.drive(200)
    world.run(2.0, None)
    world.request(RequestKind.ESTOP)
    world.run(1.0, None)
    world.request(RequestKind.RESET)
    world.run(0.5, None)
    modes = [outputs.mode for _, outputs in world.records]
    assert {Mode.IDLE, Mode.STARTING, Mode.DRIVE, Mode.STOPPING, Mode.ESTOP} == set(modes)
    assert [one.code for record in world.packets for one in causes(record)] == ["mode_estop"]


# what is kept in memory

STEPS = st.lists(
    st.tuples(st.sampled_from(["cycle"] * 6 + ["snapshot", "gap"]), st.integers(1, 700), st.integers(0, 300)),
    min_size=20,
    max_size=80,
)


@given(steps=STEPS, keep_ms=st.integers(0, 5000), forget=st.integers(1, 7))
@settings(max_examples=150)
def test_what_is_needed_is_there_in_order_and_no_more(
    steps: list[tuple[str, int, int]], keep_ms: int, forget: int
) -> None:
    """Against a list of all: from the last snapshot that is old enough, or, where there is none, from the first."""
    ring, now_ns = Ring(piece=500), 10**12
    told: list[tuple[int, Packet]] = []
    for number, (kind, way_ms, size) in enumerate(steps):
        if kind == "cycle" or not told:
            now_ns += way_ms * MS
            padded = Gap(number, number, "x" * size)
            ring.cycle(encode(padded), now_ns)
            told.append((now_ns, padded))
        elif kind == "snapshot":
            state = Snapshot(number, bytes(size % 100))
            ring.snapshot(encode(state))
            told.append((now_ns, state))
        else:
            gap = Gap(number, number, "missing")
            ring.gap(encode(gap))
            told.append((now_ns, gap))
        if number % forget == 0:
            ring.forget(now_ns - keep_ms * MS)
    since_ns = now_ns - keep_ms * MS
    found = [packet for piece in ring.since(since_ns) for packet in packets(piece)]
    everything = [packet for _, packet in told]
    assert found == everything[len(everything) - len(found) :]
    begins = [place for place, (ns, packet) in enumerate(told) if isinstance(packet, Snapshot) and ns <= since_ns]
    wanted = begins[-1] if begins else 0
    if not begins and told[0][0] < since_ns - LATE_NS:
        return  # without any snapshot in time the oldest are given up
    assert len(found) == len(everything) - wanted


def test_memory_is_bounded_whatever_comes() -> None:
    """No snapshot, incompressible cycles, and a window that is never closed."""
    ring = Ring(most=1_000_000)
    for number in range(3000):
        ring.cycle(os.urandom(2000), number)
        ring.forget(0)
        assert ring.size <= 1_000_000 + 2 * PIECE_BYTES
    assert ring.size > 500_000
    without_snapshots = Ring()
    for number in range(1000):
        without_snapshots.cycle(encode(Gap(number, number, "x" * 2000)), number * 100 * MS)
        without_snapshots.forget(number * 100 * MS - 1000 * MS)
    kept_cycles = sum(len(packets(piece)) for piece in without_snapshots.since(0))
    assert 100 <= kept_cycles <= 10 * LATE_NS // 1_000_000_000 + 10 + 33  # what is late, and a piece


# windows


def collected(given: Given, robot_config_pre: float = 1.0) -> Incidents:
    config = short(robot(Path("nowhere")), Path("nowhere"), pre=robot_config_pre)
    return Incidents(config, hello(config), None, write=given)


def feed(found: Incidents, *records: Record) -> None:
    for record in records:
        found.take(record, encode(record))
        found.poll()


FAULT = Event(Level.ERROR, "mode_fault", "drive -> fault")


def test_a_window_ends_after_its_time_and_not_before() -> None:
    given = Given()
    found = collected(given)
    feed(found, *[cycle(number) for number in range(1, 200)], cycle(200, FAULT))
    assert found.report().pending
    feed(found, *[cycle(number) for number in range(201, 250)])
    assert given.orders == []
    feed(found, cycle(250))
    (order,) = given.orders
    assert [cause.cycle for cause in order.incident.causes] == [200]
    numbers = [one.inputs.cycle for piece in order.pieces for one in packets(piece) if isinstance(one, Record)]
    assert numbers[-1] == 250
    assert numbers[0] <= 100


def test_one_is_written_at_a_time_and_the_next_wait_in_memory() -> None:
    given = Given(None)
    found = collected(given)
    for number in range(1, 1200):
        feed(found, cycle(number, *([FAULT] if number % 300 == 0 else [])))
    assert len(given.orders) == 1
    assert found.report() == IncidentReport(0, 0, None, None, pending=True)
    given.answer = Written("one.rrd", "identical", None)
    feed(found, cycle(1200))
    assert found.report()[:3] == (1, 0, "one.rrd")
    feed(found, cycle(1201), cycle(1202))
    assert [order.incident.causes[0].cycle for order in given.orders] == [300, 600, 900]
    numbers = [
        one.inputs.cycle for piece in given.orders[1].pieces for one in packets(piece) if isinstance(one, Record)
    ]
    assert min(numbers) <= 500
    assert max(numbers) >= 650


def test_too_many_at_once_are_counted_and_told() -> None:
    given = Given(None)
    found = collected(given)
    for number in range(1, 300 * (MOST_WINDOWS + 3)):
        feed(found, cycle(number, *([FAULT] if number % 300 == 0 else [])))
    report = found.report()
    assert report.failed == 1
    assert report.error == "an incident is not kept: mode_fault: 4 others are still to be written"
    assert report.pending


def test_a_flood_of_causes_is_counted_beyond_what_is_listed() -> None:
    given = Given()
    found = collected(given)
    flood = tuple(Request(RequestKind.MARK, number, 0, text=str(number)) for number in range(80))
    feed(found, cycle(1, requests=flood), *[cycle(number) for number in range(2, 60)])
    (order,) = given.orders
    assert (len(order.incident.causes), order.incident.more) == (MOST_CAUSES, 80 - MOST_CAUSES)


def test_the_state_of_the_buses_is_that_of_the_cause() -> None:
    given = Given()
    found = collected(given)
    down = cycle(3)
    event = BusEvent("can0", BusEventKind.DOWN, 1, "network is down")
    dropped = BusEvent("can0", BusEventKind.TX_DROPPED, 5, "queue full")
    feed(found, Record(down.inputs._replace(bus_events=(event, dropped)), down.outputs, down.timing))
    feed(found, cycle(9, FAULT))
    up = cycle(10)
    feed(found, Record(up.inputs._replace(bus_events=(event._replace(kind=BusEventKind.UP),)), up.outputs, up.timing))
    found.close()
    (bus,) = given.orders[0].incident.buses
    assert (bus.name, bus.state, bus.text, bus.cycle) == ("can0", "down", "network is down", 3)


@pytest.mark.parametrize(("mode", "code"), [(Mode.ESTOP, "mode_estop"), (Mode.FAULT, "mode_fault"), (Mode.IDLE, None)])
def test_what_a_gap_hides_is_seen_behind_it(mode: Mode, code: str | None) -> None:
    given = Given()
    found = collected(given)
    feed(found, *[in_mode(number, Mode.DRIVE) for number in range(1, 50)])
    gap = Gap(50, 60, "the recorder could not keep up")
    found.take(gap, encode(gap))
    feed(found, *[in_mode(number, mode) for number in range(61, 200)])
    assert [order.incident.causes[0].code for order in given.orders] == ([] if code is None else [code])
    found.take(gap, encode(gap))  # nothing is new behind the next one
    feed(found, *[in_mode(number, mode) for number in range(210, 300)])
    assert len(given.orders) == (code is not None)


def in_mode(number: int, mode: Mode) -> Record:
    plain = cycle(number)
    return Record(plain.inputs, plain.outputs._replace(mode=mode), plain.timing)


def test_every_code_can_stand_in_a_name(tmp_path: Path) -> None:
    """What does not would be in nobody's budget."""
    codes = [f"fault_{kind.value}" for kind in FaultKind] + [f"bus_{kind.value}" for kind in BusEventKind]
    codes += [f"mode_{mode.value}" for mode in Mode] + ["mark", "balance_lost"]
    for code in codes:
        name = new_incident(tmp_path, "moby", STARTED_NS, Cause(1, 1, 1, code, "").name)
        (tmp_path / f"{name}.rrd").touch()
    assert len(incidents(tmp_path, "moby")) == len(codes)


def test_a_process_that_cannot_be_started_leaves_nothing_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(3):
        with pytest.raises(FileNotFoundError):
            WritingProcess(b"order")
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_process_that_cannot_be_started_costs_the_incident_and_nothing_else() -> None:
    given = Given()
    given.error = OSError(11, "Resource temporarily unavailable")
    found = collected(given)
    feed(found, cycle(1, FAULT), *[cycle(number) for number in range(2, 60)])
    report = found.report()
    assert (report.kept, report.failed, report.pending) == (0, 1, False)
    assert "cannot be started: Resource temporarily unavailable" in str(report.error)
    given.error = None
    feed(found, cycle(400, FAULT), *[cycle(number) for number in range(401, 460)])
    assert len(given.orders) == 1


# the process that writes


@pytest.fixture(scope="module")
def order() -> Iterator[Order]:
    """Of a mark in a drive of moby; its directory is `nowhere` until it is replaced."""
    world = MarkedWorld("moby", [200])
    world.drive(300)
    config = short(world.config, Path("nowhere"))
    (found,) = orders(world, config, with_snapshots(config, world.packets, (50, 150)))
    yield found


def into(order: Order, directory: Path, *, budget: int = 10**9, min_free: int = 1_000_000) -> Order:
    driven = RobotConfig.model_validate_json(order.hello.config_json)
    config = with_budget(short(driven, directory, min_free=min_free), budget)
    return msgspec.structs.replace(order, hello=order.hello._replace(config_json=config.model_dump_json()))


def finished(process: WritingProcess) -> Written:
    descriptor, deadline = os.pidfd_open(process.pid), time.monotonic() + PATIENCE_S
    while (written := process.written()) is None:
        assert time.monotonic() < deadline
        select.select([descriptor], [], [], 0.1)
    os.close(descriptor)
    return written


def left(directory: Path) -> list[str]:
    return sorted(path.name for path in (directory / INCIDENTS).iterdir() if path.name != SUMS)


def test_in_a_process_of_its_own(order: Order, tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        in_a_process_of_its_own(order, tmp_path)
    finally:
        os.umask(before)


def in_a_process_of_its_own(order: Order, tmp_path: Path) -> None:
    """Its modes are as they should be, whatever the umask."""
    written = finished(WritingProcess(encode(into(order, tmp_path))))
    assert (written.verdict, written.error) == ("identical", None)
    path = Path(str(written.file))
    assert left(tmp_path) == [path.name]
    assert verify(open_session(path)).identical
    assert path.stat().st_mode & 0o777 == 0o640
    assert path.parent.stat().st_mode & 0o777 == 0o750


def test_it_is_the_last_that_gets_the_processor_and_the_first_to_go(order: Order, tmp_path: Path) -> None:
    process = WritingProcess(encode(into(order, tmp_path)))
    seen = set()
    descriptor = os.pidfd_open(process.pid)
    while not select.select([descriptor], [], [], 0.01)[0]:
        status = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        seen.add((int(status[16]), int(Path(f"/proc/{process.pid}/oom_score_adj").read_text())))
    os.close(descriptor)
    assert (19, 1000) in seen
    assert process.written() is not None


def test_a_killed_process_leaves_words_and_its_remains_are_cleared(order: Order, tmp_path: Path) -> None:
    process = WritingProcess(encode(into(order, tmp_path)))
    os.kill(process.pid, signal.SIGKILL)
    written = finished(process)
    assert written.error == "the process that writes it ended without a word (exit code -9)"
    (tmp_path / INCIDENTS).mkdir(exist_ok=True)
    (tmp_path / INCIDENTS / "moby-20260921T141320Z-fault-3.part").write_bytes(b"half of it")
    again = finished(WritingProcess(encode(into(order, tmp_path))))
    assert left(tmp_path) == [Path(str(again.file)).name]


def test_a_stuck_process_is_ended(order: Order, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(incidents_module, "WRITING_LIMIT_S", 0.0)
    monkeypatch.setattr(incidents_module, "PROGRAM", ("-c", "import time; time.sleep(1000)"))
    process = WritingProcess(encode(into(order, tmp_path)))
    assert finished(process).error == "the process that writes it ended without a word (exit code -9)"


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
from gateway.recording import bundle
bundle.STUCK_S = 5
bundle._leave(bundle.main(int(sys.argv[1]), int(sys.argv[2])))
"""


def test_a_disk_that_runs_full_while_it_writes(order: Order, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A real error of the kernel, as when the disk is full: it is told, and nothing is taken for a whole file.

    Rerun may be stuck then, for ever; what is left of it is cleared by the next.
    """
    monkeypatch.setattr(incidents_module, "PROGRAM", ("-c", LIMITED))
    written = finished(WritingProcess(encode(into(order, tmp_path))))
    assert written.file is None
    assert written.error
    assert incidents(tmp_path / INCIDENTS, "moby") == []
    assert left(tmp_path) == [] or written.error == STUCK
    again = kept(into(order, tmp_path))
    assert left(tmp_path) == [Path(str(again.file)).name]


STUCK_PROGRAM = """
import sys
from gateway.recording import bundle
from gateway.recording.segment import Segment

def write(*_):  # a call that never returns and never lets go of the interpreter
    sys.setswitchinterval(1e9)
    while True:
        pass

Segment.write = write
bundle.STUCK_S = 2
bundle._leave(bundle.main(int(sys.argv[1]), int(sys.argv[2])))
"""


def test_one_that_is_stuck_in_writing_ends_itself(
    order: Order, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also when nobody is there any more who would end it."""
    monkeypatch.setattr(incidents_module, "PROGRAM", ("-c", STUCK_PROGRAM))
    assert finished(WritingProcess(encode(into(order, tmp_path)))).error == STUCK


def test_no_room_is_told_and_nothing_deleted_in_vain(order: Order, tmp_path: Path) -> None:
    first = kept(into(order, tmp_path))
    with pytest.raises(IncidentError, match=r"disk full: .* bytes free at .*, recording.min_free is 10000000000000"):
        kept(into(order, tmp_path, min_free=10**13))
    assert left(tmp_path) == [Path(str(first.file)).name]
    config = with_budget(short(robot(tmp_path), tmp_path), 1_000_000)
    with pytest.raises(IncidentError, match=r"it has 2000000 bytes, recording.incidents.budget is 1000000"):
        bundle._make_room(tmp_path / INCIDENTS / "moby-20260921T141320Z-mark-2.rrd", config, 2_000_000)
    assert left(tmp_path) == [Path(str(first.file)).name]
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match="file"):
        kept(into(order, tmp_path / "file"))


def test_the_oldest_go_by_their_numbers_and_only_those_of_this_robot(order: Order, tmp_path: Path) -> None:
    folder = tmp_path / INCIDENTS
    size = Path(str(kept(into(order, tmp_path)).file)).stat().st_size
    others = ["moby-two-20260921T141320Z-mark-1.rrd", "omni4-20260921T141320Z-mark-1.rrd", "notes.txt", "moby.rrd"]
    for name in others:
        (folder / name).write_bytes(bytes(3 * size))
    (folder / "moby-20300101T000000Z-estop-7.rrd").write_bytes(bytes(600_000))  # a clock that was wrong
    (folder / "moby-19700101T000000Z-estop-8.rrd").write_bytes(bytes(600_000))
    (folder / "moby-19700101T000001Z-estop-9.rrd").symlink_to(folder / "notes.txt")
    written = kept(into(order, tmp_path, budget=1_000_000 + size))  # it needs more than the oldest takes up
    assert [number for number, _ in incidents(folder, "moby")] == [8, 9]
    assert Path(str(written.file)).name.endswith("-mark-9.rrd")
    assert {*others, "moby-19700101T000001Z-estop-9.rrd"} <= set(left(tmp_path))


def test_its_digest_is_noted_as_long_as_it_is_there(order: Order, tmp_path: Path) -> None:
    folder = tmp_path / INCIDENTS
    first = Path(str(kept(into(order, tmp_path)).file))
    second = Path(str(kept(into(order, tmp_path)).file))
    check = ["sha256sum", "--check", "--strict", SUMS]
    done = subprocess.run(check, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, f"{first.name}: OK\n{second.name}: OK\n")
    assert (folder / SUMS).stat().st_mode & 0o777 == 0o640
    (folder / "moby-20260921T000000Z-mark-3.rrd").write_bytes(bytes(1_000_000))
    budget = 1_000_000 + 2 * first.stat().st_size + second.stat().st_size // 2
    third = Path(str(kept(into(order, tmp_path, budget=budget)).file))
    assert left(tmp_path) == sorted([first.name, "moby-20260921T000000Z-mark-3.rrd", third.name])
    assert subprocess.run(check, cwd=folder, capture_output=True, check=False).returncode == 0
    assert second.name not in (folder / SUMS).read_text()
    (folder / SUMS).write_text(f"{'0' * 64}  {third.name}\n")
    assert "does not fit SHA256SUMS" in str(open_session(third).problem)
    assert open_session(first).problem is None, "one that is older, or was copied, is not in it"


def test_digests_that_cannot_be_rewritten_cost_no_incident(
    order: Order, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(_folder: Path, _names: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(bundle, "forget_sums", full)
    (tmp_path / INCIDENTS).mkdir()
    (tmp_path / INCIDENTS / "moby-20260921T000000Z-mark-1.rrd").write_bytes(bytes(1_000_000))
    written = Path(str(kept(into(order, tmp_path, budget=1_000_000)).file))
    assert left(tmp_path) == [written.name]
    assert "digests of what was deleted are still noted: [Errno 28] No space left on device" in caplog.text


# Days from one to the next (a clock may be wrong), cause, bytes.
ARRIVALS = st.lists(
    st.tuples(
        st.sampled_from([0, 0, 0, 0, 1, -5]),
        st.sampled_from(["fault_silent", "fault_silent", "bus_down", "estop"]),
        st.integers(1, 40),
    ),
    max_size=60,
)


@given(arrivals=ARRIVALS, budget=st.integers(40, 200))
@settings(max_examples=300)
def test_the_middle_of_a_series_goes_first_and_its_first_last(
    arrivals: list[tuple[int, str, int]], budget: int
) -> None:
    """Laws of the order, each from what is there and what has gone, and not from how it is found."""
    there: dict[IncidentFile, int] = {}
    day = 50
    for number, (days, cause, size) in enumerate(arrivals):
        day += days
        coming = IncidentFile(number, str(day), cause, Path(str(number)))
        before = sorted(there)
        order = expendable(before, coming)
        assert sorted(order) == before, "each of them once, and not the one that comes"
        gone: list[IncidentFile] = []
        while sum(there.values()) + size > budget:
            gone.append(order[len(gone)])
            del there[gone[-1]]
        there[coming] = size
        check_order(before, coming, gone)


def check_order(before: list[IncidentFile], coming: IncidentFile, gone: list[IncidentFile]) -> None:
    left_ = [one for one in before if one not in gone]
    for one in gone:
        if in_the_middle(one, before, coming):
            assert not [other for other in left_ if in_the_middle(other, before, coming) and other < one]
            continue
        assert not [other for other in left_ if in_the_middle(other, before, coming)], "those go first"
        began = {other.day: other.number for other in reversed([*before, coming])}
        assert not [other for other in left_ if began[other.day] < began[one.day]], "then what is of the oldest day"
        if not siblings(one, before, before=True):
            same_day = [other for other in left_ if other.day == one.day]
            assert not [other for other in same_day if siblings(other, before, before=True)], (
                "a first goes last of its day"
            )
            assert not [other for other in same_day if other < one]


def siblings(one: IncidentFile, found: list[IncidentFile], *, before: bool) -> list[IncidentFile]:
    """Of the same cause on the same day, before it or behind."""
    return [
        other
        for other in found
        if (other.day, other.cause) == (one.day, one.cause) and other != one and (other.number < one.number) is before
    ]


def in_the_middle(one: IncidentFile, found: list[IncidentFile], coming: IncidentFile) -> bool:
    return bool(siblings(one, found, before=True) and siblings(one, [*found, coming], before=False))


def test_a_fault_that_flaps_for_hours_leaves_the_first_of_it_and_of_every_other() -> None:
    there = [IncidentFile(1, "20260921", "estop", Path("1")), IncidentFile(2, "20260921", "fault_silent", Path("2"))]
    for number in range(3, 1000):
        coming = IncidentFile(number, "20260921", "fault_silent", Path(str(number)))
        if len(there) == 4:
            there.remove(expendable(there, coming)[0])
        there.append(coming)
    assert [one.number for one in there] == [1, 2, 998, 999]


def test_names(tmp_path: Path) -> None:
    assert new_incident(tmp_path, "moby", STARTED_NS, "estop") == "moby-20260921T141320Z-estop-1"
    for name in ("moby-20260921T141320Z-estop-9.rrd", "moby-20260921T141320Z-fault_silent-10.rrd", "x.part"):
        (tmp_path / name).touch()
    assert new_incident(tmp_path, "moby", STARTED_NS, "mark") == "moby-20260921T141320Z-mark-11"
    assert Cause(1, 1, 1, "mode_estop", "").name == "estop"
    clear(tmp_path, "moby")
    assert (tmp_path / "x.part").exists()


def test_neither_the_service_nor_its_side_of_the_recording_knows_of_it() -> None:
    """Nothing of an incident but a person's mark passes through the loop."""
    code = (
        "import sys, gateway.service, gateway.recording.recorder; "
        "print([name for name in sys.modules if name in "
        "{f'gateway.recording.{one}' for one in ('incident', 'incidents', 'bundle', 'ring', 'judge')}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_without_sessions_the_process_does_without_rerun() -> None:
    code = "import sys, gateway.recording.process; print({'rerun', 'pyarrow', 'numpy'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "rerun" not in done.stdout
    assert "pyarrow" not in done.stdout
