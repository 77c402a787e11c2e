"""Which gamepad is taken, and what is said where none can be: sysfs as Linux shows it, and events through a pipe.

On real devices of a real kernel: `tests.vm.test_input_pads`.
"""

import errno
import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from runpy import run_path

import pytest

from gateway.edges.evdev import Gamepad, GamepadError, open_gamepad
from gateway.teleop.pad import Axis
from gateway.types import Twist

# As a kernel shows an Xbox pad, a DualSense with its motion sensors, a flight stick and a keyboard.
XPAD = ("Microsoft X-Box 360 pad", "045e", "028e", "7cdb000000000000 0 0 0 0", "3003f")
DUALSENSE = ("DualSense Wireless Controller", "054c", "0ce6", "7fdb000000000000 0 0 0 0", "3003f")
MOTION = ("DualSense Wireless Controller Motion Sensors", "054c", "0ce6", "0", "3f")
STICK = ("Extreme 3D", "046d", "c215", "fff00000000 0 0 0 0", "63")
KEYBOARD = ("Keyboard", "046d", "c31c", "1000000000007 ff9f207ac14057ff febeffdfffefffff fffffffffffffffe", "0")
CENTRED = Axis(0, -32768, 32767, 128)


class Machine:
    """A computer with these devices, event0, event1, ...; nodes are pipes into which events may be put."""

    def __init__(self, folder: Path) -> None:
        self.sysfs, self.dev = folder / "sysfs", folder / "dev"
        self.sysfs.mkdir()
        self.dev.mkdir()
        self.count = 0

    def plug(self, name: str, vendor: str, product: str, key: str, absolute: str) -> Path:
        told = self.sysfs / f"event{self.count}" / "device"
        (told / "id").mkdir(parents=True)
        (told / "capabilities").mkdir()
        for path, text in (
            *(("name", name), ("id/vendor", vendor), ("id/product", product)),
            *(("capabilities/key", key), ("capabilities/abs", absolute)),
        ):
            (told / path).write_text(f"{text}\n")
        node = self.dev / f"event{self.count}"
        os.mkfifo(node)
        self.count += 1
        return node

    def open(self, wanted: str | None = None) -> Gamepad:
        return open_gamepad(wanted, sysfs=self.sysfs, dev=self.dev)

    def refusal(self, wanted: str | None = None) -> str:
        with pytest.raises(GamepadError) as refused:
            self.open(wanted)
        return str(refused.value).replace(str(self.dev), "/dev/input")


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    monkeypatch.setattr(Gamepad, "_axis", lambda _self, _code: CENTRED)
    return Machine(tmp_path)


def test_the_only_pad_is_taken(machine: Machine) -> None:
    machine.plug(*KEYBOARD)
    node = machine.plug(*XPAD)
    machine.plug(*MOTION)
    with machine.open() as gamepad:
        assert gamepad.device.path == str(node)
        assert gamepad.layout.deadman_name == "LB"


def test_of_several_one_must_be_named(machine: Machine) -> None:
    machine.plug(*XPAD)
    second = machine.plug(*DUALSENSE)
    assert machine.refusal() == (
        "there is /dev/input/event0 (Microsoft X-Box 360 pad, 045e:028e), "
        "/dev/input/event1 (DualSense Wireless Controller, 054c:0ce6): say which one with --device"
    )
    link = machine.dev / "by-id-event-joystick"
    link.symlink_to(second)
    for wanted in (str(second), "event1", "dualsense", str(link)):
        with machine.open(wanted) as gamepad:
            assert gamepad.device.path == str(second)
    assert machine.refusal("thrustmaster").startswith("thrustmaster is no gamepad here; there is /dev/input/event0 (")


def test_without_a_pad(machine: Machine) -> None:
    assert machine.refusal() == "there is no gamepad: this computer has no /dev/input"
    machine.plug(*KEYBOARD)
    assert machine.refusal() == "there is no gamepad: none of the 1 input devices has its buttons"
    assert machine.refusal("xbox") == "xbox is no gamepad here; there is none"


def test_a_pad_whose_sticks_are_unknown_is_refused_with_what_it_has(machine: Machine) -> None:
    machine.plug(*STICK)
    assert machine.refusal() == (
        "/dev/input/event0 (Extreme 3D, 046d:c215): its sticks and buttons are not known; it has axes X, Y, RZ, 0x06; "
        "buttons 0x120, 0x121, 0x122, 0x123, 0x124, 0x125, 0x126, 0x127, 0x128, 0x129, 0x12a, 0x12b"
    )


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            PermissionError(errno.EACCES, "Permission denied"),
            "may not be opened: as root `usermod -aG input USER`, then",
        ),
        (OSError(errno.ENODEV, "No such device"), "cannot be opened: No such device"),
    ],
)
def test_a_pad_that_cannot_be_opened(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, error: OSError, words: str
) -> None:
    def refuse(*_: object) -> int:
        raise error

    machine.plug(*XPAD)
    monkeypatch.setattr("gateway.edges.evdev.os.open", refuse)
    assert words in machine.refusal()
    assert "Microsoft X-Box 360 pad" in machine.refusal()


def test_a_range_that_is_none_is_refused(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine.plug(*XPAD)
    monkeypatch.setattr(Gamepad, "_axis", lambda _self, code: CENTRED._replace(minimum=32767) if code == 1 else CENTRED)
    before = len(list(Path("/proc/self/fd").iterdir()))
    assert machine.refusal().endswith("cannot be used: axis Y goes from 32767 to 32767")
    assert len(list(Path("/proc/self/fd").iterdir())) == before


@pytest.fixture
def opened(machine: Machine) -> Iterator[tuple[Gamepad, int]]:
    """A pad and where its events go in."""
    node = machine.plug(*XPAD)
    with machine.open() as gamepad:
        writing = os.open(node, os.O_WRONLY)
        yield gamepad, writing
        os.close(writing)


def put(descriptor: int, *events: tuple[int, int, int]) -> None:
    os.write(descriptor, b"".join(struct.pack("@qqHHi", 1, 2, *event) for event in events))


def test_events_reach_the_pad(opened: tuple[Gamepad, int]) -> None:
    gamepad, writing = opened
    assert not gamepad.read(1.0), "nothing has come"
    put(writing, (1, 0x136, 1), (0, 0, 0), (3, 1, -32768), (0, 0, 0))
    assert not gamepad.read(1.0)
    wish = gamepad.pad.wish(1.0)
    assert wish.press == 1
    assert wish.direction.vx == pytest.approx(1.0)
    put(writing, (1, 0x131, 1))
    assert gamepad.read(1.1)
    assert gamepad.pad.wish(1.1).stop


def test_behind_lost_events_the_axes_are_asked_for(
    opened: tuple[Gamepad, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    gamepad, writing = opened
    monkeypatch.setattr(Gamepad, "_axis", lambda _self, code: CENTRED._replace(value=32767 if code == 0 else 0))
    put(writing, (1, 0x136, 1))
    gamepad.read(1.0)
    put(writing, (3, 1, -32768), (0, 3, 0))
    assert gamepad.read(1.0), "the press has ended"
    wish = gamepad.pad.wish(1.0)
    assert wish.press is None
    assert wish.direction == pytest.approx(Twist(0.0, -1.0, 0.0), abs=1e-4)


def test_a_pad_that_is_gone(opened: tuple[Gamepad, int], monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object) -> bytes:
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr("gateway.edges.evdev.os.read", gone)
    with pytest.raises(GamepadError, match=r"is gone: No such device; nothing drives before this is called again"):
        opened[0].read(1.0)


def test_a_name_is_no_order_to_a_terminal(machine: Machine) -> None:
    machine.plug("pad\x1b[2J", *STICK[1:])
    assert "(pad?[2J, 046d:c215)" in machine.refusal()


def test_those_of_a_real_kernel_are_collected_without_the_other_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "evdev", None)  # not for every processor
    assert "test_the_stop_button_latches" in run_path(str(Path(__file__).parents[1] / "vm" / "test_input_pads.py"))
