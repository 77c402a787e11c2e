"""The installed service under systemd on bad days: killed, hung, without recorder, disk, robot file or interface."""

import contextlib
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.recording.disk import INCIDENTS
from gateway.types import Mode
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.vm.installed_robot import (
    CONFIG,
    DEVICE_WATCHDOG_S,
    NODES,
    ORDINARY,
    SESSIONS,
    UNIT,
    Commander,
    armed_nodes,
    journal,
    main_pid,
    newest_session,
    recorder_pid,
    robot_text,
    run,
    show,
    systemctl,
    wait_active,
    wait_for,
)
from tests.vm.vcan_robot import faster_than, in_mode, shell

pytestmark = [pytest.mark.systemd, pytest.mark.timeout(300)]

DEVICE = "sys-subsystem-net-devices-vcan0.device"


def drive(commander: Commander) -> None:
    commander.start()
    commander.say(0.3)
    commander.await_state(faster_than(0.2))


def recording(commander: Commander) -> dict[str, object]:
    """What the next state says of the recording."""
    found = commander.await_state(lambda state: "recording" in state.extras).extras["recording"]
    assert isinstance(found, dict)
    return found


def test_killed_while_driving_the_motors_stop_themselves_and_motion_needs_a_zero(
    running: Commander, tell: Callable[[str], None]
) -> None:
    drive(running)
    assert armed_nodes() == set(NODES)
    restarts = int(show("NRestarts"))
    killed = time.monotonic()
    os.kill(main_pid(), signal.SIGKILL)
    while armed_nodes():
        assert time.monotonic() - killed < 5.0, "the motors' own watchdogs did not stop them"
    seconds = time.monotonic() - killed
    tell(f"SIGKILL to no motor driven: {seconds:.2f} s (watchdog of the motors {DEVICE_WATCHDOG_S} s)")
    wait_active(restarts=restarts + 1)
    tell(f"SIGKILL to READY again: {time.monotonic() - killed:.1f} s")

    reason = "waiting for a zero command from teleop"
    running.await_state(lambda state: state.status.reason == reason)
    for state in running.states(20):
        assert state.status.mode is Mode.IDLE
    assert armed_nodes() == set()
    drive(running)
    running.silence()
    running.await_state(in_mode(Mode.IDLE))


def test_a_hung_loop_is_killed_by_the_watchdog_and_comes_back_idle(running: Commander) -> None:
    drive(running)
    running.silence()
    restarts = int(show("NRestarts"))
    os.kill(main_pid(), signal.SIGSTOP)
    wait_active(restarts=restarts + 1)
    assert running.await_state(lambda state: not state.status.faults).status.mode is Mode.IDLE
    words = journal()
    assert "Watchdog timeout" in words
    assert "Fatal Python error: Aborted" in words, "the stacks of the hung process are in the journal"


def test_driving_goes_on_without_recorder_which_comes_back_and_marks_the_gap(running: Commander) -> None:
    drive(running)
    pid, dead = main_pid(), recorder_pid()
    os.kill(dead, signal.SIGKILL)
    gone = running.await_state(lambda state: state.extras["recording"]["alive"] is False)  # type: ignore[index]
    assert gone.status.mode is Mode.DRIVE
    back = running.await_state(lambda state: state.extras["recording"]["alive"] is True)  # type: ignore[index]
    assert back.status.mode is Mode.DRIVE or running.held_up()
    wait_for(lambda: recording(running)["error"] is None, "recording again")
    assert running.await_state(lambda _: True).status.mode is Mode.DRIVE or running.held_up()
    assert main_pid() == pid
    assert os.sched_getscheduler(recorder_pid()) in ORDINARY
    wait_for(lambda: bool(open_session(newest_session()).gaps), "the gap is in the session")
    assert open_session(newest_session()).gaps[-1].reason == "the recorder process ended (exit code -9)"


def test_driving_goes_on_when_the_disk_is_full_and_recording_when_it_is_not(running: Commander) -> None:
    drive(running)
    pid = main_pid()
    before = running.await_state(lambda _: True).status.cycle
    filler = SESSIONS / "filler"

    def full() -> bool:
        """Take what is left, again and again: the recorder makes room by giving up the robot's older sessions."""
        room = os.statvfs(SESSIONS)
        with filler.open("ab") as file, contextlib.suppress(OSError):
            os.posix_fallocate(file.fileno(), filler.stat().st_size, room.f_bavail * room.f_frsize)
        return "disk full" in str(recording(running)["error"])

    try:
        wait_for(full, "the state says that nothing is recorded")
        drive(running)  # on, or again if taking the room has held up the commander for too long
    finally:
        filler.unlink()
    wait_for(lambda: recording(running)["error"] is None, "recording again")
    drive(running)
    assert main_pid() == pid
    # Not their number: the session may have given up its own first segments, with an older gap in them. Nor a cycle
    # from when the disk was found full: what is lost is the batch before that, and room may be back before the next.
    wait_for(lambda: any(gap.last_cycle >= before for gap in open_session(newest_session()).gaps), "the gap is in it")


def test_an_emergency_stop_is_kept_by_a_process_in_the_sandbox(running: Commander) -> None:
    drive(running)
    pid, before = main_pid(), incidents(running)["kept"]
    assert running.client.stop(30.0)
    wait_for(lambda: incidents(running)["kept"] != before, "the incident is kept", timeout=200.0)
    assert incidents(running)["error"] is None
    path = Path(str(incidents(running)["file"]))
    assert path.parent == SESSIONS / INCIDENTS
    assert verify(open_session(path)).identical
    assert main_pid() == pid
    running.silence()
    wait_for(lambda: running.client.reset(5.0).ok, "released")


def incidents(commander: Commander) -> dict[str, object]:
    """What the next state says of them."""
    found = recording(commander)["incidents"]
    assert isinstance(found, dict)
    return found


def test_a_wrong_robot_file_is_exit_78_and_no_restart() -> None:
    text = robot_text().replace("wheel_radius = 0.10", "wheel_radius = -0.10")
    (CONFIG / "broken.toml").write_text(text, encoding="utf-8")
    assert run("systemctl", "start", "drivegate@broken.service").code == 1
    unit = "drivegate@broken.service"
    assert show("SubState", unit) == "failed"
    assert show("ExecMainStatus", unit) == "78"
    assert show("NRestarts", unit) == "0"
    assert "wheel_radius = -0.1: must be a number, 0.001 to 10 m" in journal(unit)
    systemctl("reset-failed", unit)
    (CONFIG / "broken.toml").unlink()


def test_a_missing_interface_is_waited_for_and_a_deleted_one_stops_the_service(running: Commander) -> None:
    pid = main_pid()
    shell("ip link del vcan0")
    wait_for(lambda: show("ActiveState") == "inactive", "bound to its interface")
    assert not Path(f"/proc/{pid}").exists()
    systemctl("start", "--no-block", UNIT)
    wait_for(lambda: show("ActiveState", DEVICE) == "inactive" and show("Job", DEVICE) != "0", "its start job waits")
    assert f"{UNIT} start waiting" in " ".join(systemctl("list-jobs").split())
    doctor = run("/opt/drivegate/bin/python", "-m", "gateway", "doctor", "moby")
    assert doctor.code == 1
    assert "CAN vcan0: there is no such interface" in doctor.output
    assert f"{UNIT}: its start waits for its CAN interface to appear" in doctor.output
    shell("ip link add dev vcan0 type vcan; ip link set vcan0 up")
    wait_active()
    assert running.await_state(lambda state: not state.status.faults).status.mode is Mode.IDLE
