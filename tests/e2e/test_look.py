"""The live view of a running service: what is seen is what is recorded, and who looks on costs no cycle, no record."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest
import rerun as rr
import rerun.blueprint as rrb

from gateway.cli.look import Follower
from gateway.client import Client
from gateway.types import Mode
from tests.drawn import STATIC, drawn
from tests.e2e.robot_process import RobotProcess, faster_than, in_mode, standing
from tests.gateway.test_zenoh_link import eventually
from tests.world import NAMES

HALF_SECOND = 125  # cycles, of which every bundled robot has 250 a second


@pytest.mark.parametrize("name", NAMES)
def test_what_is_seen_is_what_the_session_shows(name: str, tmp_path: Path, free_port: int) -> None:
    path = tmp_path / "live.rrd"

    def opens(recording: rr.RecordingStream, layout: rrb.Blueprint) -> None:
        recording.save(path, default_blueprint=layout)

    with RobotProcess(name, tmp_path, free_port) as robot, Client(name, connect=[robot.endpoint]) as client:
        follower = Follower(client, opens, lambda _: None)
        Thread(target=follower.draw_for_ever, daemon=True).start()
        eventually(lambda: follower.recordings)  # it stands until then, so that the path begins at one place
        begun = robot.start().status.cycle
        robot.stream(0.3, 0.0, 0.2, until=lambda state: state.status.cycle > begun + 4 * HALF_SECOND)
        seen = robot.await_state(standing).status.cycle  # it stands: this much is in the files, and more
        robot.await_state(lambda state: state.status.cycle > seen + HALF_SECOND)
        assert robot.end() == 0
        eventually(lambda: not client.alive)
        assert follower._recording is not None
        follower._recording.close()
        assert robot.verify().identical
    live = drawn([path])
    (session,) = (one for one in tmp_path.iterdir() if one.is_dir())
    recorded = drawn(sorted(session.glob("*.rrd")))
    first = min(cycle for cycle in live["/trace/pose"] if cycle != STATIC)
    settled = first + HALF_SECOND + 5  # from then on every CAN message has had its first of the half second
    assert settled < seen - HALF_SECOND
    assert live.keys() == recorded.keys()
    for entity, rows in recorded.items():
        assert between(live[entity], first + HALF_SECOND + 5, seen) == between(rows, first + HALF_SECOND + 5, seen), (
            entity
        )


def between(rows: dict[int, list[str]], first: int, last: int) -> dict[int, list[str]]:
    return {cycle: cells for cycle, cells in rows.items() if first <= cycle <= last or cycle == STATIC}


@contextmanager
def watching(robot: RobotProcess, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """`drivegate watch --viewer`, its viewer a page."""
    command = [sys.executable, "-m", "gateway", "watch", robot.name, "--viewer", "--web", "--connect", robot.endpoint]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output, stdin=subprocess.DEVNULL)
    try:
        wait_for(lambda: f"looking at {robot.name}" in log.read_text() or process.poll() is not None)
        assert process.poll() is None, log.read_text()
        yield process
    finally:
        for child in children(process.pid):
            os.kill(child, signal.SIGKILL)
        process.kill()
        process.wait()


def wait_for(probe: Callable[[], object]) -> None:
    """The viewer takes longer to start than what `eventually` waits for."""
    for last in (False, False, True):
        try:
            eventually(probe)
        except pytest.fail.Exception:
            if last:
                raise
        else:
            return


def children(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in path.read_text().split()] if path.exists() else []


def running(pid: int) -> bool:
    try:
        return "zombie" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_ends_all_that_was_started(number: int, tmp_path: Path, free_port: int) -> None:
    with RobotProcess("omni4", tmp_path, free_port) as robot, watching(robot, tmp_path / "watch.log") as watch:
        (viewer,) = children(watch.pid)
        watch.send_signal(number)
        assert watch.wait(20.0) == 0
        assert not running(viewer)
        which, page, *others = (tmp_path / "watch.log").read_text().splitlines()
        assert which.startswith("omni4: as given by --connect")
        assert page.startswith("look at http://127.0.0.1:")
        assert others == ["looking at omni4"]


def test_a_viewer_that_hangs_is_ended_too(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("omni4", tmp_path, free_port) as robot, watching(robot, tmp_path / "watch.log") as watch:
        (viewer,) = children(watch.pid)
        os.kill(viewer, signal.SIGSTOP)
        watch.send_signal(signal.SIGINT)
        assert watch.wait(20.0) == 0
        assert not running(viewer)


def test_a_viewer_that_is_closed_ends_the_command(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("omni4", tmp_path, free_port) as robot, watching(robot, tmp_path / "watch.log") as watch:
        os.kill(children(watch.pid)[0], signal.SIGTERM)
        assert watch.wait(20.0) == 0


def test_one_who_is_killed_leaves_no_viewer_behind(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("omni4", tmp_path, free_port) as robot, watching(robot, tmp_path / "watch.log") as watch:
        (viewer,) = children(watch.pid)
        os.kill(viewer, signal.SIGSTOP)
        watch.kill()
        eventually(lambda: not running(viewer))


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_one_who_looks_on_and_freezes_or_dies_costs_no_cycle_and_no_record(
    number: int, tmp_path: Path, free_port: int
) -> None:
    with RobotProcess("moby", tmp_path, free_port) as robot, watching(robot, tmp_path / "watch.log") as watch:
        viewers = children(watch.pid)
        robot.start()
        cycle = robot.stream(0.3, 0.0, 0.0, until=faster_than(0.25)).status.cycle
        watch.send_signal(number)
        # Longer than Zenoh's lease, by which it throws the frozen one out.
        later = robot.stream(0.3, 0.0, 0.1, until=lambda state: state.status.cycle > cycle + 800)
        assert later.status.mode is Mode.DRIVE
        assert later.status.dropped_records == 0
        if number == signal.SIGSTOP:
            watch.send_signal(signal.SIGCONT)
            log = tmp_path / "watch.log"
            wait_for(lambda: "heard again" in log.read_text())
            assert "moby was restarted" not in log.read_text()
        robot.await_state(in_mode(Mode.IDLE))
        assert robot.end() == 0
        verdict = robot.verify()
        assert verdict.identical
        assert verdict.problem is None, "no record is missing"
    for viewer in viewers:
        if running(viewer):
            os.kill(viewer, signal.SIGKILL)


def test_a_service_that_starts_again_is_seen_again(tmp_path: Path, free_port: int) -> None:
    log = tmp_path / "watch.log"
    with RobotProcess("omni4", tmp_path, free_port) as robot, watching(robot, log) as watch:
        robot.end(signal.SIGKILL)
        wait_for(lambda: "omni4 is gone: waiting for it" in log.read_text())
        with RobotProcess("omni4", tmp_path, free_port):
            wait_for(lambda: "omni4 was restarted" in log.read_text())
            watch.send_signal(signal.SIGINT)
            assert watch.wait(20.0) == 0
