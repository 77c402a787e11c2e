"""Gamepads of a real kernel (uinput makes them, evdev shows them), and the command that drives a robot with one."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Self

import pytest

from gateway.edges.evdev import GamepadError, open_gamepad
from gateway.edges.messages import StateMessage
from gateway.errors import EXIT_UNAVAILABLE
from gateway.teleop import pad as codes
from gateway.teleop.pad import SILENT_S
from gateway.types import Mode
from tests.e2e.robot_process import RobotProcess, faster_than, in_mode, standing
from tests.vm.vcan_robot import drivegate, end, paced
from tests.world import ROBOTS

pytestmark = pytest.mark.input

PORT = 7481
WAIT_S = 40.0
FULL = -32768
STICK_AXES = (codes.ABS_X, codes.ABS_Y, codes.ABS_RX, codes.ABS_RY)
BTN_TR = 0x137
BUTTONS = (codes.BTN_SOUTH, codes.BTN_EAST, codes.BTN_TL, BTN_TR)


class VirtualPad:
    """An Xbox pad as the kernel's xpad driver makes it; unplugged at the end of the block."""

    def __init__(self, name: str = "Virtual pad") -> None:
        evdev = import_module("evdev")  # it is not for every processor
        axes = [(code, evdev.AbsInfo(0, FULL, 32767, 16, 128, 0)) for code in STICK_AXES]
        axes.append((codes.ABS_HAT0Y, evdev.AbsInfo(0, -1, 1, 0, 0, 0)))
        events: dict[int, Sequence[Any]] = {codes.EV_KEY: BUTTONS, codes.EV_ABS: axes}
        self._device = evdev.UInput(events, name=name, vendor=codes.MICROSOFT, product=0x028E)
        self._wiggles = 0

    def put(self, kind: int, code: int, value: int) -> None:
        self._device.write(kind, code, value)
        self._device.syn()

    def hold(self, button: int = codes.BTN_TL, *, down: bool = True) -> None:
        self.put(codes.EV_KEY, button, int(down))

    def forward(self, value: int = FULL) -> None:
        self.put(codes.EV_ABS, codes.ABS_Y, value)

    def wiggle(self) -> None:
        """As a thumb does that holds the stick."""
        self._wiggles += 1
        self.forward(FULL + 100 * (self._wiggles % 2))

    def unplug(self) -> None:
        self._device.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()


class Drive:
    """`drivegate drive omni4 --gamepad` without a terminal."""

    def __init__(self, directory: Path) -> None:
        self.log = directory / f"drive-{time.monotonic_ns()}.log"
        where = ("--connect", f"tcp/127.0.0.1:{PORT}")
        self.process = drivegate("drive", "omni4", "--gamepad", *where, log=self.log)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        end(self.process, signal.SIGKILL)

    def words(self) -> str:
        return self.log.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RobotProcess]:
    directory = tmp_path_factory.mktemp("robot")
    file = directory / "omni4.toml"
    file.write_text(paced((ROBOTS / "omni4.toml").read_text(encoding="utf-8")), encoding="utf-8")
    with RobotProcess("omni4", directory, PORT, file=file) as started:
        yield started


@pytest.fixture
def pad() -> Iterator[VirtualPad]:
    with VirtualPad() as plugged:
        yield plugged


@pytest.fixture
def drive(robot: RobotProcess, pad: VirtualPad) -> Iterator[Drive]:
    """The command runs with the pad, and the robot is ready."""
    with Drive(robot.directory) as running:
        robot.await_state(in_mode(Mode.DRIVE), WAIT_S)
        yield running
    robot.await_state(in_mode(Mode.IDLE), WAIT_S)  # whatever happened


def while_wiggling(
    robot: RobotProcess, pad: VirtualPad, until: Callable[[StateMessage], bool], timeout: float = WAIT_S
) -> None:
    assert reached(robot, pad, until, timeout), f"not reached: {robot.client.state()}"


def reached(robot: RobotProcess, pad: VirtualPad, until: Callable[[StateMessage], bool], timeout: float) -> bool:
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        pad.wiggle()
        if fresh(robot, until):
            return True
    return False


def fresh(robot: RobotProcess, until: Callable[[StateMessage], bool]) -> bool:
    seen = robot.client.state()
    return robot.client.wait_for_state(lambda state: state is not seen and until(state), 0.1) is not None


def drives(robot: RobotProcess, pad: VirtualPad) -> None:
    """Pressed anew now and then: before the command has heard that the robot is ready it does not count."""
    for _ in range(10):
        pad.forward(0)
        pad.hold(down=False)
        pad.hold()
        if reached(robot, pad, faster_than(0.2), timeout=4.0):
            return
    raise AssertionError(f"does not drive: {robot.client.state()}")


def at_rest(state: StateMessage) -> bool:
    return standing(state) and not faster_than(0.001)(state)


def test_driven_let_go_and_driven_again(robot: RobotProcess, pad: VirtualPad, drive: Drive) -> None:
    drives(robot, pad)
    pad.hold(down=False)
    while_wiggling(robot, pad, at_rest)  # the stick is still out
    assert robot.client.state() is not None
    assert in_mode(Mode.DRIVE)(robot.await_state(lambda _: True)), "zeros go on"
    drives(robot, pad)
    assert "gamepad /dev/input/event" in drive.words()
    drive.process.send_signal(signal.SIGTERM)
    assert drive.process.wait(WAIT_S) == 0
    robot.await_state(at_rest, WAIT_S)


def test_what_is_held_at_the_start_does_not_count(robot: RobotProcess, pad: VirtualPad) -> None:
    pad.hold()
    before = robot.await_state(in_mode(Mode.IDLE), WAIT_S).status.pose
    with Drive(robot.directory):
        while_wiggling(robot, pad, in_mode(Mode.DRIVE))
        since = robot.await_state(lambda _: True).status.cycle
        while_wiggling(robot, pad, lambda state: state.status.cycle > since + 100)
        after = robot.await_state(at_rest).status.pose
        assert abs(after.x - before.x) < 0.001
        drives(robot, pad)
    robot.await_state(in_mode(Mode.IDLE), WAIT_S)


def test_the_stop_button_latches(robot: RobotProcess, pad: VirtualPad, drive: Drive) -> None:
    drives(robot, pad)
    pad.hold(codes.BTN_EAST)
    while_wiggling(robot, pad, in_mode(Mode.ESTOP))
    pad.hold(codes.BTN_EAST, down=False)
    pad.hold(down=False)
    pad.forward(0)
    robot.await_state(lambda state: in_mode(Mode.ESTOP)(state) and at_rest(state), WAIT_S)
    pad.hold()
    while_wiggling(robot, pad, in_mode(Mode.ESTOP))
    pad.hold(down=False)
    assert robot.client.reset().ok
    while_wiggling(robot, pad, in_mode(Mode.DRIVE))
    drives(robot, pad)


def test_unplugged_it_ends_at_rest_and_plugged_again_nothing_drives(
    robot: RobotProcess, drive: Drive, pad: VirtualPad
) -> None:
    drives(robot, pad)
    pad.unplug()
    assert drive.process.wait(WAIT_S) == EXIT_UNAVAILABLE
    assert "is gone: No such device; nothing drives before this is called again" in drive.words()
    robot.await_state(at_rest, WAIT_S)
    with VirtualPad() as again:
        again.hold()
        robot.await_state(in_mode(Mode.IDLE), WAIT_S)
        since = robot.await_state(lambda _: True).status.cycle
        while_wiggling(robot, again, lambda state: state.status.cycle > since + 100)
        robot.await_state(lambda state: in_mode(Mode.IDLE)(state) and at_rest(state))


def test_a_pad_that_falls_silent_with_a_stick_out(robot: RobotProcess, pad: VirtualPad, drive: Drive) -> None:
    drives(robot, pad)
    robot.await_state(at_rest, SILENT_S + WAIT_S)
    since = robot.await_state(lambda _: True).status.cycle
    while_wiggling(robot, pad, lambda state: state.status.cycle > since + 100)
    robot.await_state(at_rest)
    assert drive.process.poll() is None
    drives(robot, pad)


def test_a_command_that_is_stopped_and_goes_on_wants_another_press(
    robot: RobotProcess, pad: VirtualPad, drive: Drive
) -> None:
    """Meanwhile the kernel's buffer of 64 events runs over, and the release is among what is lost."""
    drives(robot, pad)
    drive.process.send_signal(signal.SIGSTOP)
    robot.await_state(at_rest, WAIT_S)
    for _ in range(200):
        pad.wiggle()
    pad.hold(down=False)
    pad.hold()
    for _ in range(200):
        pad.wiggle()
    drive.process.send_signal(signal.SIGCONT)
    since = robot.await_state(lambda _: True).status.cycle
    while_wiggling(robot, pad, lambda state: state.status.cycle > since + 100)
    robot.await_state(at_rest)
    drives(robot, pad)


def test_what_the_kernel_drops_is_noticed(pad: VirtualPad) -> None:
    with open_gamepad(None) as gamepad:
        pad.hold()
        gamepad.read(0.0)
        assert gamepad.pad.wish(0.0).press == 1
        for number in range(200):
            pad.forward(FULL + 100 * number)
        while gamepad.read(0.1):
            pass
        assert gamepad.pad.wish(0.1).press is None
        assert gamepad.pad.axes[codes.ABS_Y].value == FULL + 100 * 199
        assert gamepad.pad.why == "events of the pad were lost"


def test_two_pads_of_which_one_may_not_be_opened(pad: VirtualPad) -> None:
    assert pad is not None
    with VirtualPad("The other one"):
        with pytest.raises(GamepadError, match="The other one, 045e:028e\\): say which one with --device"):
            open_gamepad(None)
        with open_gamepad("other") as gamepad:
            assert gamepad.device.name == "The other one"
            path = gamepad.device.path
        reader = os.fork()
        if reader == 0:
            os.setuid(65534)
            try:
                open_gamepad("other")
            except GamepadError as refused:
                os._exit(0 if f"{path} (The other one) may not be opened: as root `usermod" in str(refused) else 1)
            os._exit(2)
        assert os.waitpid(reader, 0)[1] == 0
