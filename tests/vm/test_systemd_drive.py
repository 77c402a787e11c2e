"""The installed service under systemd on a good day: it waits for what it needs, drives, and ends in order."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.types import Mode
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.vm.installed_robot import (
    ORDINARY,
    UNIT,
    Commander,
    Motors,
    armed_nodes,
    install,
    journal,
    main_pid,
    newest_session,
    recorder_pid,
    run,
    show,
    systemctl,
    wait_active,
    wait_for,
)
from tests.vm.vcan_robot import faster_than, in_mode, shell, standing

pytestmark = [pytest.mark.systemd, pytest.mark.timeout(300)]


def test_the_machine_is_up_and_nothing_failed() -> None:
    assert run("systemctl", "is-system-running", "--wait").output in {"running", "degraded"}
    assert systemctl("--failed", "--no-legend", "--plain") == ""


def test_ready_waits_for_the_bus_and_says_why(motors: Motors) -> None:
    motors.off()
    wait_for(lambda: show("StatusText").startswith("waiting: can0: "), "the status text names the bus")
    assert "down" in show("StatusText")
    assert show("ActiveState") == "activating"
    shell("ip link set vcan0 up")
    wait_active()
    assert "declared absent: left, right, platform" in journal()
    systemctl("stop", UNIT)


def test_ready_with_answering_motors(motors: Motors, commander: Commander, tell: Callable[[str], None]) -> None:
    motors.on()
    begin = time.monotonic()
    systemctl("start", UNIT)
    seconds = time.monotonic() - begin
    tell(f"systemctl start to READY: {seconds:.1f} s (in the virtual machine)")
    assert show("StatusText").startswith("idle, standing: ")
    assert journal().count("declared absent") == 1
    assert commander.await_state(lambda state: not state.status.faults).status.mode is Mode.IDLE


def test_real_time_for_the_loop_and_its_threads_but_not_for_the_recorder(
    running: Commander, tell: Callable[[str], None]
) -> None:
    assert running.client.alive
    threads = list(Path(f"/proc/{main_pid()}/task").iterdir())
    real_time = {
        (thread / "comm").read_text(encoding="ascii").strip()
        for thread in threads
        if os.sched_getscheduler(int(thread.name)) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
    }
    assert real_time == {"python"}, "the threads that take the interpreter lock, not Zenoh's own"
    assert os.sched_getscheduler(recorder_pid()) in ORDINARY
    status = Path(f"/proc/{main_pid()}/status").read_text(encoding="ascii")
    locked_kb = int(status.partition("VmLck:")[2].split()[0])
    resident_kb = int(status.partition("VmRSS:")[2].split()[0])
    tell(f"locked {locked_kb >> 10} MB mapped, {resident_kb >> 10} MB resident")
    assert locked_kb > 0
    assert resident_kb < 300_000


def test_an_upgrade_is_refused_while_driving(running: Commander) -> None:
    running.start()
    running.say(0.3)
    running.await_state(faster_than(0.2))
    wait_for(lambda: show("StatusText").startswith("drive, moving"), "the status text says so")
    refused = install()
    assert refused.code == 1
    assert "moby is not at rest (drive, moving" in refused.output
    running.await_state(in_mode(Mode.DRIVE))


def test_stop_while_driving_brings_to_rest_and_closes_the_recording(running: Commander) -> None:
    running.start()
    running.say(0.3)
    running.await_state(faster_than(0.28))
    state = running.await_state(in_mode(Mode.DRIVE))
    pid = main_pid()
    systemctl("stop", UNIT)
    running.silence()
    assert not Path(f"/proc/{pid}").exists()
    assert show("Result") == "success"
    assert armed_nodes() == set()
    recording = state.extras["recording"]
    assert isinstance(recording, dict)
    assert Path(recording["session"]) == newest_session()
    session = open_session(newest_session())
    assert session.complete
    *_, (inputs, last) = session.cycles()
    assert last.mode is Mode.IDLE
    verdict = verify(session)
    assert verdict.identical, verdict
    assert verdict.cycles == inputs.cycle + 1


def test_it_starts_again_at_rest(running: Commander) -> None:
    state = running.await_state(standing)
    assert state.status.mode is Mode.IDLE
