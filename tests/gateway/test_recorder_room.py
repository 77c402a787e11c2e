"""Room on the disk: what goes when there is none, in which order, and what never goes. And who may read it."""

import os
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.recording.disk import Hold, new_session, segment_number, segment_path, segments, sessions, stored_bytes
from gateway.recording.packets import Gap
from gateway.recording.recorder import Recorder
from gateway.recording.writer import SessionWriter
from replay.compare.verify import verify
from replay.sessions.reader import PRUNED, open_session
from tests.drives import drive
from tests.recordings import STARTED_NS, expected, robot, robot_text, write, write_drive, writer
from tests.world import World

BUDGET, SEGMENT = 1_020_000, 300_000  # a segment of one batch has some 322 kB
BATCH = 250


def old_session(
    directory: Path, robot_name: str = "moby", *, started_ns: int = STARTED_NS, size: int = 540_000
) -> Path:
    folder = new_session(directory, robot_name, started_ns)
    segment_path(folder, 1).write_bytes(bytes(size))
    return folder


def small(directory: Path, folder: Path | None = None) -> SessionWriter:
    """Each batch is a segment; two closed ones and the open one fit the budget."""
    return writer(directory, folder=folder, segment_bytes=SEGMENT, disk_budget=BUDGET)


def record(session: SessionWriter, batches: int) -> int:
    """Most bytes that all sessions of the robot had at any time."""
    most = 0
    for number in range(batches):
        session.write(list(drive(BATCH, first=number * BATCH)))
        most = max(most, stored_bytes(session.folder.parent, "moby"))
    return most


def left(folder: Path) -> list[int | None]:
    return [segment_number(path) for path in segments(folder)]


def test_the_running_session_is_bound_by_the_budget(tmp_path: Path) -> None:
    session = small(tmp_path)
    assert record(session, 12) <= BUDGET
    session.close()
    assert stored_bytes(tmp_path, "moby") <= BUDGET
    read = open_session(session.folder)
    assert len(read.segments) >= 2
    first = read.header.segment
    assert first > 2
    assert left(session.folder) == list(range(first, first + len(read.segments)))
    (gap,) = read.gaps
    cycles = [inputs.cycle for inputs, _ in read.cycles()]
    assert gap == Gap(0, cycles[0] - 1, PRUNED)
    assert cycles == list(range(cycles[0], 12 * BATCH))
    assert read.pruned
    assert [problem for problem in read.problems if "segment" in problem] == []


def test_a_segment_is_never_more_than_half_of_the_budget(tmp_path: Path) -> None:
    session = writer(tmp_path, disk_budget=BUDGET)
    assert record(session, 12) <= BUDGET
    session.close()
    assert max(path.stat().st_size for path in segments(session.folder)) <= BUDGET // 2


def test_what_was_pruned_is_incomplete_and_not_different(tmp_path: Path) -> None:
    world = World("moby")
    world.start()
    world.run(0.8)
    folder = write_drive(tmp_path, world, batch=80, segment_bytes=60_000, disk_budget=600_000)
    assert segments(folder)[0].name != "segment-00001.rrd"
    verdict = verify(open_session(folder))
    assert (verdict.exit_code, verdict.cycles, verdict.first_difference) == (3, 0, None)
    assert PRUNED in (verdict.problem or "")


def test_a_restarted_recorder_still_knows_what_was_pruned(tmp_path: Path) -> None:
    first = small(tmp_path)
    record(first, 8)
    first.close(ended=False)
    assert 1 not in left(first.folder)
    second = small(tmp_path, first.folder)
    second.write(list(drive(10, first=8 * BATCH)))
    second.close()
    read = open_session(first.folder)
    assert read.pruned
    assert read.gaps[0].reason == PRUNED


def test_a_segment_taken_by_hand_is_not_called_pruned(tmp_path: Path) -> None:
    session = writer(tmp_path, segment_bytes=60_000)
    record(session, 3)
    session.close()
    segment_path(session.folder, 1).unlink()
    read = open_session(session.folder)
    assert not read.pruned
    assert "segments 1 to 1 are missing" in read.problems


def test_older_sessions_go_before_own_segments(tmp_path: Path) -> None:
    older = [old_session(tmp_path) for _ in range(2)]
    session = small(tmp_path)
    session.write(list(drive(BATCH)))
    assert [folder.exists() for folder in older] == [False, True]
    record(session, 2)
    assert [folder.exists() for folder in older] == [False, False]
    assert left(session.folder)[0] == 1
    session.close()


def test_a_full_disk_takes_the_oldest_and_loses_no_cycle(tmp_path: Path) -> None:
    """The free space is that of a disk which holds our recordings and nothing else."""
    disk = 3_200_000
    old = old_session(tmp_path)
    session = writer(tmp_path, segment_bytes=60_000, free=lambda _: disk - stored_bytes(tmp_path, "moby"))
    record(session, 12)
    session.close()
    assert session.report().lost == 0
    assert session.report().error is None
    assert not old.exists()
    read = open_session(session.folder)
    assert [gap.reason for gap in read.gaps] == [PRUNED]
    assert [inputs.cycle for inputs, _ in read.cycles()][-1] == 12 * BATCH - 1


def test_nothing_is_deleted_in_vain(tmp_path: Path) -> None:
    old = old_session(tmp_path)
    room = [10**9]
    session = writer(tmp_path, segment_bytes=60_000, free=lambda _: room[0])
    record(session, 2)
    room[0] = -(10**8)  # others have filled the disk
    session.write(list(drive(BATCH, first=2 * BATCH)))
    assert session.report().lost == BATCH
    assert segments(old)
    assert left(session.folder) == [1, 2]
    session.close()


def test_order_is_that_of_making_whatever_the_clock_says(tmp_path: Path) -> None:
    first, second = (old_session(tmp_path, started_ns=year) for year in (STARTED_NS, 0))
    unnumbered = tmp_path / "moby-20990101T000000Z"
    unnumbered.mkdir()
    segment_path(unnumbered, 1).write_bytes(bytes(900_000))
    assert second.name == "moby-19700101T000000Z"
    assert sessions(tmp_path, "moby") == [unnumbered, first, second]
    session = writer(tmp_path, segment_bytes=500_000, disk_budget=2_000_000)
    session.open()
    assert [folder.exists() for folder in (unnumbered, first, second)] == [False, True, True]
    session.close()


def test_sessions_of_one_second(tmp_path: Path) -> None:
    folders = [new_session(tmp_path, "moby", STARTED_NS) for _ in range(11)]
    assert sessions(tmp_path, "moby") == folders
    for folder in folders:
        (folder / ".sequence").unlink()
    assert sessions(tmp_path, "moby") == folders


@pytest.mark.parametrize("content", ["", "-5", "1e9", "\0" * 8, "9" * 40])
def test_a_spoilt_number_counts_as_none(tmp_path: Path, content: str) -> None:
    (new_session(tmp_path, "moby", STARTED_NS) / ".sequence").write_text(content)
    again = new_session(tmp_path, "moby", STARTED_NS)
    assert (again / ".sequence").read_text() == "1\n"


@contextmanager
def held_elsewhere(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that records into this folder."""
    code = (
        "import sys; from pathlib import Path; from gateway.recording.disk import Hold; "
        "hold = Hold(Path(sys.argv[1])); print(hold.held, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "True\n"
        try:
            yield process
        finally:
            process.kill()


def test_never_what_another_process_writes_until_it_has_ended(tmp_path: Path) -> None:
    old = old_session(tmp_path, size=3_000_000)
    session = small(tmp_path)
    with held_elsewhere(old):
        record(session, 2)
        assert segments(old)
        assert left(session.folder) == [2]  # the budget holds all the same
    record(session, 2)
    assert not old.exists()
    session.close()


def test_never_a_session_made_later(tmp_path: Path) -> None:
    session = small(tmp_path)
    later = old_session(tmp_path, started_ns=0)
    record(session, 3)
    session.close()
    assert segments(later)


def test_a_running_writer_holds_its_folder(tmp_path: Path) -> None:
    session = writer(tmp_path)
    session.write(list(drive(5)))
    assert not Hold(session.folder).held
    session.close()
    lock = Hold(session.folder)
    assert lock.held
    lock.release()


def linked_session(directory: Path, elsewhere: Path) -> Path:
    kept = old_session(elsewhere, size=3_000_000)
    link = directory / "moby-19990101T000000Z"
    link.symlink_to(kept)
    return segment_path(kept, 1)


def linked_segment(directory: Path, elsewhere: Path) -> Path:
    kept = elsewhere / "kept.rrd"
    elsewhere.mkdir()
    kept.write_bytes(bytes(3_000_000))
    segment_path(old_session(directory), 2).symlink_to(kept)
    return kept


def of_another_robot(directory: Path, _: Path) -> Path:
    return segment_path(old_session(directory, "moby-2", size=3_000_000), 1)


def notes(directory: Path, _: Path) -> Path:
    note = old_session(directory) / "notes.txt"
    note.write_text("keep me")
    return note


@pytest.mark.parametrize("make", [linked_session, linked_segment, of_another_robot, notes])
def test_never_what_is_not_ours(tmp_path: Path, make: Callable[[Path, Path], Path]) -> None:
    directory = tmp_path / "sessions"
    directory.mkdir()
    kept = make(directory, tmp_path / "elsewhere")
    size = kept.stat().st_size
    links = [path for path in directory.rglob("*") if path.is_symlink()]
    session = small(directory)
    record(session, 6)
    session.close()
    assert kept.stat().st_size == size
    assert all(link.is_symlink() for link in links)
    assert left(session.folder) == [4, 5, 6]  # room was needed, and none for what is not ours


def test_more_than_99999_segments_are_read_in_order(tmp_path: Path) -> None:
    session = writer(tmp_path, segment_bytes=60_000)
    for number in (0, 99_999):
        session._number = number
        session.write(list(drive(10, first=10 if number else 0)))
        session._opened_ns -= 400 * 10**9
    session.close()
    assert [path.name for path in open_session(session.folder).segments] == ["segment-00001.rrd", "segment-100000.rrd"]
    assert [inputs.cycle for inputs, _ in open_session(session.folder).cycles()] == list(range(20))


def modes(folder: Path) -> set[tuple[str, str]]:
    return {(path.name, stat.filemode(path.stat().st_mode)) for path in (folder, *folder.iterdir())}


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_recordings_are_for_the_group_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        recorder = Recorder(robot(tmp_path), robot_text(), "moby.toml")
        record_ = next(iter(drive(1)))
        recorder.put(record_.inputs, record_.outputs, record_.timing)
        assert recorder.close()
        assert recorder.session is not None
        here = write(tmp_path, list(drive(3)))
    finally:
        os.umask(before)
    for folder in (recorder.session, here):
        assert modes(folder) == {
            (folder.name, "drwxr-x---"),
            (".sequence", "-rw-r-----"),
            ("SHA256SUMS", "-rw-r-----"),
            ("segment-00001.rrd", "-rw-r-----"),
        }
    assert list(open_session(here).cycles()) == expected(list(drive(3)))
