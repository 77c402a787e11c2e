"""What is done to a running service from outside: its output is not read, it is signalled, frozen, killed."""

import signal
import time
from pathlib import Path

import pytest

from gateway.edges.messages import StateMessage
from gateway.types import Mode
from tests.e2e.robot_process import RobotProcess, faster_than, in_mode, standing
from tests.unread import UNREAD, Unread
from tests.world import NAMES

GO = (0.3, 0.0, 0.0)
FROZEN_S = 1.5  # less than the lease after which Zenoh would throw the commands away with the connection


def moving(robot: RobotProcess) -> StateMessage:
    robot.start()
    return robot.stream(*GO, until=faster_than(0.25))


def heard_and_standing(state: StateMessage) -> bool:
    return state.status.winner == "teleop" and standing(state)


@pytest.mark.parametrize("blocked", UNREAD)
def test_an_output_that_nobody_reads_holds_up_no_cycle_no_stop_and_no_end(
    blocked: Unread, tmp_path: Path, free_port: int
) -> None:
    with blocked() as stderr, RobotProcess("moby", tmp_path, free_port, stderr=stderr) as robot:
        cycle = moving(robot).status.cycle
        for _ in range(5):  # each refusal is told in words
            assert not robot.client.reset().ok
        robot.client.stop()
        state = robot.await_state(in_mode(Mode.ESTOP))
        assert state.status.cycle > cycle
        state = robot.await_state(standing)
        robot.await_state(lambda later: later.status.cycle > state.status.cycle)
        assert robot.end() == 0
        assert robot.verify().identical


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGTSTP])
def test_a_signal_that_would_end_the_process_brings_the_robot_to_rest_first(
    number: int, tmp_path: Path, free_port: int
) -> None:
    with RobotProcess("moby", tmp_path, free_port) as robot:
        moving(robot)
        robot.process.send_signal(number)
        robot.process.send_signal(number)
        robot.await_state(in_mode(Mode.STOPPING))
        assert robot.process.wait(60.0) == 0
        assert f"signal {int(number)}: coming to rest" in robot.log.read_text()
        verdict = robot.verify()
        assert verdict.identical
        assert verdict.problem is None


def test_a_signal_during_the_start_ends_it_in_order(tmp_path: Path, free_port: int) -> None:
    robot = RobotProcess("moby", tmp_path, free_port, wait=False)
    while not robot.listens_to(signal.SIGHUP):
        assert robot.process.poll() is None, robot.log.read_text()
        time.sleep(0.001)
    assert robot.end(signal.SIGHUP) == 0
    robot.client.close()
    assert "signal 1: coming to rest" in robot.log.read_text()


def test_a_latched_emergency_stop_outlives_a_kill_and_a_reset_ends_it(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("moby", tmp_path, free_port) as robot:
        moving(robot)
        robot.client.stop()
        robot.await_state(in_mode(Mode.ESTOP))
        robot.end(signal.SIGKILL)
    assert (tmp_path / "moby.estop").is_file(), "whoever was told of it may rely on it"

    with RobotProcess("moby", tmp_path, free_port) as robot:
        seen = robot.stream(0.0, 0.0, 0.0, until=heard_and_standing)
        assert seen.status.mode is Mode.ESTOP
        assert seen.extras["estop_latch"] == {"on_disk": True, "problem": None}
        assert "the emergency stop is kept: emergency stop requested, set 20" in robot.log.read_text()
        assert robot.client.reset().ok
        robot.await_state(in_mode(Mode.STARTING, Mode.DRIVE, Mode.STOPPING, Mode.IDLE))
        robot.await_state(lambda state: state.extras["estop_latch"] == {"on_disk": False, "problem": None})
        robot.end(signal.SIGKILL)

    with RobotProcess("moby", tmp_path, free_port) as robot:
        assert robot.await_state(lambda _: True).status.mode is Mode.IDLE


@pytest.mark.parametrize("name", NAMES)
def test_frozen_while_driving_it_does_not_go_on_with_what_came_before(
    name: str, tmp_path: Path, free_port: int
) -> None:
    """Commands that wait in the sockets of a frozen service are of the past when it goes on."""
    with RobotProcess(name, tmp_path, free_port) as robot:
        cycle = moving(robot).status.cycle
        robot.process.send_signal(signal.SIGSTOP)
        frozen = time.monotonic()
        while time.monotonic() < frozen + 0.3:
            robot.client.send_twist(*GO, source="teleop")
            time.sleep(0.02)
        time.sleep(FROZEN_S - 0.3)  # the commander has died
        robot.process.send_signal(signal.SIGCONT)
        seen: list[Mode] = []

        def at_rest(state: StateMessage) -> bool:
            if state.status.cycle > cycle + 5:  # what was said before it froze
                seen.append(state.status.mode)
            return state.status.mode is Mode.IDLE

        robot.await_state(at_rest)
        assert Mode.DRIVE not in seen
