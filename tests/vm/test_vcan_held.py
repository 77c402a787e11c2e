"""What is done from outside to a service that drives on a real bus: unread output, a hangup, freezing, a kill."""

import signal
import time
from pathlib import Path

import pytest

from gateway.edges.messages import StateMessage
from gateway.types import Mode
from replay.compare.verify import verify
from tests.unread import UNREAD, Unread
from tests.vm.vcan_robot import GO, ZERO, Condition, VcanRobot, candump, end, fresh_vcan0, heard, in_mode, standing
from tests.world import NAMES

pytestmark = pytest.mark.vcan

FROZEN_S = 1.5  # less than the lease after which Zenoh would throw the commands away with the connection


@pytest.mark.parametrize("blocked", UNREAD)
@pytest.mark.parametrize("name", NAMES)
def test_an_output_that_nobody_reads_holds_up_no_stop_and_no_end(
    name: str, blocked: Unread, tmp_path: Path, free_port: int
) -> None:
    fresh_vcan0()
    with blocked() as stderr, VcanRobot(name, tmp_path, free_port, stderr=stderr) as robot:
        robot.drive()
        robot.client.stop()
        stopped = robot.stream(GO, in_mode(Mode.ESTOP))
        state = robot.stream(GO, standing)
        assert state.status.cycle > stopped.status.cycle
        robot.await_truth_at_rest(GO)
        session = robot.finish()
    verdict = verify(session)
    assert verdict.identical, verdict


@pytest.mark.parametrize("name", NAMES)
def test_a_hangup_brings_it_to_rest_and_releases_the_motors(name: str, tmp_path: Path, free_port: int) -> None:
    fresh_vcan0()
    log = tmp_path / "candump.log"
    with candump(log, "vcan0"), VcanRobot(name, tmp_path, free_port) as robot:
        robot.drive()
        robot.service.send_signal(signal.SIGHUP)
        robot.stream(GO, in_mode(Mode.STOPPING, Mode.IDLE))
        assert robot.service.wait(60.0) == 0, robot.words()
        session = robot.session()
        last = [outputs for _, outputs in session.cycles()][-1]
        assert last.mode is Mode.IDLE
        assert heard(log)
        verdict = verify(session)
        assert verdict.identical, verdict


@pytest.mark.parametrize("name", NAMES)
def test_a_latched_stop_outlives_a_kill_and_a_reset_ends_it(name: str, tmp_path: Path, free_port: int) -> None:
    fresh_vcan0()
    with VcanRobot(name, tmp_path, free_port) as robot:
        robot.drive()
        robot.client.stop()
        robot.watch(in_mode(Mode.ESTOP))
        robot.await_truth_at_rest(ZERO)  # a C620 holds what it was told last
        end(robot.service, signal.SIGKILL)
        assert (tmp_path / f"{name}.estop").is_file()

        robot.restart_service()
        begun = robot.watch(fresh(robot), timeout=60.0)
        state = robot.stream(ZERO, lambda state: state.status.cycle > begun.status.cycle + 100)
        assert state.status.mode is Mode.ESTOP
        robot.watch(lambda state: state.status.winner is None and state.status.standing is True)
        assert robot.client.reset().ok, robot.words()
        robot.watch(lambda state: state.extras["estop_latch"] == {"on_disk": False, "problem": None})
        end(robot.service, signal.SIGKILL)

        robot.restart_service()
        assert robot.watch(fresh(robot), timeout=60.0).status.mode is Mode.IDLE


def fresh(robot: VcanRobot) -> Condition:
    """A state of another process than the one seen last: its cycles begin anew."""
    before = robot.client.state()
    return lambda state: before is None or state.status.cycle < before.status.cycle


@pytest.mark.parametrize("name", NAMES)
def test_frozen_while_driving_it_does_not_go_on_with_what_came_before(
    name: str, tmp_path: Path, free_port: int
) -> None:
    fresh_vcan0()
    with VcanRobot(name, tmp_path, free_port) as robot:
        cycle = robot.drive().status.cycle
        robot.service.send_signal(signal.SIGSTOP)
        frozen = time.monotonic()
        while time.monotonic() < frozen + 0.3:
            robot.client.send_twist(*GO, source="teleop")
            time.sleep(0.02)
        time.sleep(FROZEN_S - 0.3)  # the commander has died
        robot.service.send_signal(signal.SIGCONT)
        seen: list[Mode] = []

        def at_rest(state: StateMessage) -> bool:
            if state.status.cycle > cycle + 5:  # what was said before it froze
                seen.append(state.status.mode)
            return state.status.mode is Mode.IDLE

        robot.watch(at_rest)
        assert Mode.DRIVE not in seen
