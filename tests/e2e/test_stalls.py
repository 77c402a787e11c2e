"""Commands that were held back and arrive all at once: nothing drives on the words of a commander that is gone."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.edges.messages import StateMessage
from gateway.types import Mode
from tests.e2e.relay import Relay
from tests.e2e.robot_process import RobotProcess, faster_than, in_mode

SPEED = 0.6  # m/s: coming to rest takes longer than the commander's timeout, 0.2 s
HELD_BACK = 4  # commands, 20 ms apart
GONE_S = 0.25  # the commander is silent for this long before the burst arrives


def _go_silent_after(commander: Client, robot: RobotProcess) -> None:
    """A few more commands that the robot does not hear, then none for longer than the timeout."""
    for _ in range(HELD_BACK):
        commander.send_twist(SPEED, 0.0, 0.0, source="autonomy")
        robot.client.wait_for_state(lambda _: False, 0.02)
    last = time.monotonic()
    robot.client.wait_for_state(lambda _: time.monotonic() - last > GONE_S, 2.0 * GONE_S)


def _nothing_drives_again(robot: RobotProcess) -> None:
    """Until the robot is released: no mode but those of coming to rest, and the burst was seen and refused."""
    codes: list[str] = []

    def refused_and_at_rest(state: StateMessage) -> bool:
        codes.extend(event.code for event in robot.client.events())
        return state.status.mode is Mode.IDLE and "refused_stale" in codes

    robot.await_state(refused_and_at_rest)
    assert not {"mode_drive", "mode_degraded", "mode_starting"} & set(codes)


@pytest.mark.parametrize("name", ["moby", "omni4"])
def test_a_link_that_stalls_does_not_drive_a_robot_whose_commander_has_died(
    name: str, tmp_path: Path, free_port: int
) -> None:
    with (
        RobotProcess(name, tmp_path, free_port) as robot,
        Relay(free_port) as relay,
        Client(name, connect=[relay.endpoint]) as commander,
    ):
        assert commander.wait_alive(10.0)
        _stream(commander, 0.0, robot, in_mode(Mode.DRIVE))
        _stream(commander, SPEED, robot, faster_than(0.9 * SPEED))
        robot.client.events()
        relay.flowing.clear()
        _go_silent_after(commander, robot)
        robot.await_state(in_mode(Mode.STOPPING, Mode.IDLE))
        relay.flowing.set()
        _nothing_drives_again(robot)


def test_a_service_that_was_stopped_does_not_drive_on_what_waited_for_it(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("omni4", tmp_path, free_port) as robot:
        robot.stream(0.0, 0.0, 0.0, until=in_mode(Mode.DRIVE), source="autonomy")
        robot.stream(SPEED, 0.0, 0.0, until=faster_than(0.9 * SPEED), source="autonomy")
        robot.client.events()
        robot.process.send_signal(signal.SIGSTOP)
        _go_silent_after(robot.client, robot)
        robot.process.send_signal(signal.SIGCONT)
        _nothing_drives_again(robot)


def _stream(commander: Client, vx: float, robot: RobotProcess, until: Callable[[StateMessage], bool]) -> None:
    deadline = time.monotonic() + 20.0
    while not robot.client.wait_for_state(until, 0.02):
        assert time.monotonic() < deadline, robot.client.state()
        commander.send_twist(vx, 0.0, 0.0, source="autonomy")
