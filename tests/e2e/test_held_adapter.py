"""A serial adapter that never returns from a call: the loop goes on, says so, comes to rest, and ends."""

from pathlib import Path

from gateway.edges.messages import StateMessage
from gateway.types import Mode
from tests.e2e.robot_process import RobotProcess, faster_than, in_mode, standing
from tests.world import ROBOTS


def process(directory: Path, port: int) -> RobotProcess:
    text = (ROBOTS / "moby.toml").read_text(encoding="utf-8")
    assert 'interface = "socketcan"' in text
    file = directory / "moby.toml"
    file.write_text(text.replace('"socketcan"', '"slcan"'), encoding="utf-8")
    state = directory / "state"
    state.mkdir()
    return RobotProcess("moby", directory, port, "--state", str(state), module="tests.e2e.held_adapter", file=file)


def bus_is_down(state: StateMessage) -> bool:
    return any(fault.startswith("can0: ") for fault in state.status.faults)


def test_a_write_that_never_returns_ends_in_rest(tmp_path: Path, free_port: int) -> None:
    with process(tmp_path, free_port) as robot:
        robot.start()
        robot.stream(0.3, 0.0, 0.0, until=faster_than(0.2))
        (tmp_path / "send").touch()
        down = robot.stream(0.3, 0.0, 0.0, until=bus_is_down)
        assert "can0: send queue full for 25 cycles: a write does not return" in down.status.faults
        assert robot.client.stop()
        rested = robot.await_state(lambda state: standing(state) and in_mode(Mode.ESTOP)(state))
        later = robot.await_state(lambda state: state.status.cycle > rested.status.cycle + 100)
        assert bus_is_down(later)
        assert robot.end() == 0


def test_opening_that_never_returns_holds_neither_loop_nor_end(tmp_path: Path, free_port: int) -> None:
    (tmp_path / "open").touch()
    with process(tmp_path, free_port) as robot:
        first = robot.await_state(bus_is_down)
        assert "can0: slcan can0 is being opened" in first.status.faults
        robot.await_state(lambda state: state.status.cycle > first.status.cycle + 100)
        assert robot.client.stop()
        robot.await_state(in_mode(Mode.ESTOP))
        assert robot.end() == 0
