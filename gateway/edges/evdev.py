"""Gamepads as Linux shows them: /dev/input/event*, and what sysfs says of each.

The few bytes of the protocol are read here: the library for it (evdev) is compiled while it is installed, against
headers that a robot computer need not have, and its wheels are for one processor only. What a device is comes from
sysfs, which everybody may read, so that a pad that may not be opened is still named.
"""

import fcntl
import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Self

from gateway.errors import UserError
from gateway.teleop.pad import (
    Axis,
    Device,
    InputEvent,
    Pad,
    is_pad,
    layout_of,
    used,
    what_it_has,
    wrong_ranges,
)

SYSFS, DEV = Path("/sys/class/input"), Path("/dev/input")
_EVENT = struct.Struct("llHHi")  # struct input_event of linux/input.h: seconds, microseconds, type, code, value
_AXIS = struct.Struct("6i")  # struct input_absinfo: value, minimum, maximum, fuzz, flat, resolution
_WORD_BITS = 8 * struct.calcsize("l")  # of the bit maps in sysfs
_READ_EVENTS = 64
_IOC_READ = 2 << 30  # asm-generic/ioctl.h, on every processor that we run on
NO_PADS = "there is no gamepad: none of the {count} input devices has its buttons"
NO_INPUT = f"there is no gamepad: this computer has no {DEV}"
LOCKED = "{path} ({name}) may not be opened: as root `usermod -aG input USER`, then log in anew"


class GamepadError(UserError):
    """There is no gamepad to drive with, or no longer; the text says why."""


class Gamepad:
    """An open pad. Raises GamepadError when it cannot be used, or is gone."""

    def __init__(self, device: Device) -> None:
        layout = layout_of(device)
        if layout is None:
            raise GamepadError(f"{words(device)}: its sticks and buttons are not known; it has {what_it_has(device)}")
        self.device = device
        self.layout = layout
        try:
            self.descriptor = os.open(device.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except PermissionError:
            raise GamepadError(LOCKED.format(path=device.path, name=device.name)) from None
        except OSError as error:
            raise GamepadError(f"{words(device)} cannot be opened: {error.strerror}") from None
        try:
            self.pad = Pad(layout, self._usable_axes())
        except GamepadError:
            self.close()
            raise

    def read(self, now: float) -> bool:
        """Takes in what has happened, without waiting; whether it should be sent at once."""
        try:
            told = os.read(self.descriptor, _READ_EVENTS * _EVENT.size)
        except BlockingIOError:
            return False
        except OSError as error:
            raise self._gone(error) from None
        events = (InputEvent(kind, code, value) for *_, kind, code, value in _EVENT.iter_unpack(told))
        urgent = self.pad.hear(events, now)
        if self.pad.lost:
            self.pad.catch_up(self._axes())
        return urgent

    def close(self) -> None:
        """Let go of it."""
        os.close(self.descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _usable_axes(self) -> dict[int, Axis]:
        axes = self._axes()
        if wrong := wrong_ranges(axes):
            raise GamepadError(f"{words(self.device)} cannot be used: {', '.join(wrong)}")
        return axes

    def _axes(self) -> dict[int, Axis]:
        return {code: self._axis(code) for code in used(self.layout)}

    def _axis(self, code: int) -> Axis:
        """EVIOCGABS of linux/input.h."""
        number = _IOC_READ | _AXIS.size << 16 | ord("E") << 8 | 0x40 + code
        try:
            told = fcntl.ioctl(self.descriptor, number, bytes(_AXIS.size))
        except OSError as error:
            raise self._gone(error) from None
        value, minimum, maximum, _, flat, _ = _AXIS.unpack(told)
        return Axis(value, minimum, maximum, flat)

    def _gone(self, error: OSError) -> GamepadError:
        return GamepadError(
            f"{words(self.device)} is gone: {error.strerror}; nothing drives before this is called again"
        )


def open_gamepad(wanted: str | None, *, sysfs: Path = SYSFS, dev: Path = DEV) -> Gamepad:
    """The one that is meant: its path, a link to it, or a part of its name; None: the only one. Raises GamepadError."""
    devices = list(_devices(sysfs, dev))
    if not devices:
        raise GamepadError(NO_INPUT)
    pads = [device for device in devices if is_pad(device)]
    if wanted is not None:
        found = [device for device in pads if _is_meant(device, wanted)]
        if not found:
            raise GamepadError(f"{wanted} is no gamepad here; there {_listed(pads)}")
        pads = found
    if not pads:
        raise GamepadError(NO_PADS.format(count=len(devices)))
    if len(pads) > 1:
        raise GamepadError(f"there {_listed(pads)}: say which one with --device")
    return Gamepad(pads[0])


def words(device: Device) -> str:
    """A device for a person."""
    return f"{device.path} ({device.name}, {device.vendor:04x}:{device.product:04x})"


def _listed(pads: Sequence[Device]) -> str:
    return f"is {', '.join(map(words, pads))}" if pads else "is none"


def _is_meant(device: Device, wanted: str) -> bool:
    same = Path(wanted).resolve() == Path(device.path).resolve()
    return same or Path(device.path).name == wanted or wanted.lower() in device.name.lower()


def _devices(sysfs: Path, dev: Path) -> Iterator[Device]:
    """All that have a node, in the order of their numbers; one that goes meanwhile is left out."""
    for entry in sorted(sysfs.glob("event*"), key=lambda path: (len(path.name), path.name)):
        told = entry / "device"
        try:
            yield Device(
                str(dev / entry.name),
                _printable((told / "name").read_text(encoding="utf-8", errors="replace").strip()),
                int((told / "id" / "vendor").read_text(encoding="ascii"), 16),
                int((told / "id" / "product").read_text(encoding="ascii"), 16),
                _bits((told / "capabilities" / "key").read_text(encoding="ascii")),
                _bits((told / "capabilities" / "abs").read_text(encoding="ascii")),
            )
        except (OSError, ValueError):
            continue


def _printable(name: str) -> str:
    """A device says what it likes; a terminal does what it is told."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def _bits(text: str) -> frozenset[int]:
    """Of a bit map in sysfs: hexadecimal words, the highest first."""
    words_of_it = [int(word, 16) for word in reversed(text.split())]
    return frozenset(
        place * _WORD_BITS + bit
        for place, word in enumerate(words_of_it)
        for bit in range(_WORD_BITS)
        if word >> bit & 1
    )
