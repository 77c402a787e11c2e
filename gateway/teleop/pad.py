"""What a gamepad asks for: which button and axis of which pad mean what, and what its events come to.

How this works
--------------
Event codes are those of the Linux input subsystem (linux/input-event-codes.h; gamepads after the kernel's document
"Linux Gamepad Specification"), where up and left are negative. The first row of LAYOUTS that fits a device is its
layout; one that fits none is refused. A stick is measured from the middle of the range that the device tells, in which
its own flat zone or that of SHAPES counts as rest.

The dead-man counts from its own press event on, and only with all sticks at rest then: a trigger that somebody's
driver calls a stick is never at rest. Missed events, and a pad that says nothing while a stick is out, end the press.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import sqrt
from typing import NamedTuple

from gateway.teleop.hand import Wish
from gateway.types import ZERO_TWIST, Twist

EV_SYN, EV_KEY, EV_ABS = 0x00, 0x01, 0x03
SYN_DROPPED = 3
RELEASED, PRESSED = 0, 1
ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ, ABS_GAS, ABS_HAT0Y = 0x00, 0x01, 0x02, 0x03, 0x04, 0x05, 0x09, 0x11
BTN_TRIGGER, BTN_THUMB2, BTN_TOP2 = 0x120, 0x122, 0x124  # of joysticks: buttons 1, 3, 5
BTN_SOUTH, BTN_EAST, BTN_C, BTN_WEST, BTN_TL = 0x130, 0x131, 0x132, 0x134, 0x136
BTN_LAST = 0x13F
BTN_DPAD_UP, BTN_DPAD_DOWN = 0x220, 0x221
AXIS_NAMES = {0: "X", 1: "Y", 2: "Z", 3: "RX", 4: "RY", 5: "RZ", 9: "GAS", 10: "BRAKE", 16: "HAT0X", 17: "HAT0Y"}

SILENT_S = 2.0  # with a stick out: chosen; a thumb is never that still, and a pad out of reach keeps its last word


class InputEvent(NamedTuple):
    """One of the kernel's `struct input_event`."""

    kind: int
    code: int
    value: int


class Axis(NamedTuple):
    """What the device tells of one axis (`struct input_absinfo`)."""

    value: int
    minimum: int
    maximum: int
    flat: int


class Device(NamedTuple):
    """An input device: where it is, its name and ids, codes of its buttons and axes."""

    path: str
    name: str
    vendor: int
    product: int
    buttons: frozenset[int]
    axes: frozenset[int]


class Layout(NamedTuple):
    """Where the sticks and buttons of a kind of pad are, and how the two buttons are called on it."""

    deadman: int
    deadman_name: str
    stop: int
    stop_name: str
    turn: int  # axis of the right stick; the left one is ABS_X, ABS_Y on all of them
    other: int  # the right stick's other axis: both are there, or it is no stick


class _Row(NamedTuple):
    """`vendor`: None: any; `needs`: buttons and axes by which it is told from the rows below, besides those it uses."""

    vendor: int | None
    buttons: frozenset[int]
    axes: frozenset[int]
    layout: Layout


SONY, MICROSOFT = 0x054C, 0x045E
_NONE: frozenset[int] = frozenset()
_SHOULDER, _RIGHT = "the upper left shoulder button", "the right one of the four buttons"
LAYOUTS = (
    # DualShock and DualSense without the kernel's own driver (hid-playstation, hid-sony): buttons are only numbered.
    _Row(SONY, frozenset({BTN_C}), _NONE, Layout(BTN_WEST, "L1", BTN_C, "circle", ABS_Z, ABS_RZ)),
    _Row(SONY, _NONE, _NONE, Layout(BTN_TL, "L1", BTN_EAST, "circle", ABS_RX, ABS_RY)),
    _Row(MICROSOFT, _NONE, _NONE, Layout(BTN_TL, "LB", BTN_EAST, "B", ABS_RX, ABS_RY)),
    # Xbox over Bluetooth without a driver of its own: the triggers are gas and brake.
    _Row(MICROSOFT, _NONE, frozenset({ABS_GAS}), Layout(BTN_TL, "LB", BTN_EAST, "B", ABS_Z, ABS_RZ)),
    _Row(None, _NONE, _NONE, Layout(BTN_TL, _SHOULDER, BTN_EAST, _RIGHT, ABS_RX, ABS_RY)),
    _Row(None, _NONE, _NONE, Layout(BTN_TL, _SHOULDER, BTN_EAST, _RIGHT, ABS_Z, ABS_RZ)),
    # Pads that call themselves joysticks, as most without a name do.
    _Row(None, frozenset({BTN_TRIGGER}), _NONE, Layout(BTN_TOP2, "button 5", BTN_THUMB2, "button 3", ABS_Z, ABS_RZ)),
)
FASTER = {(EV_KEY, BTN_DPAD_UP, PRESSED): 1, (EV_KEY, BTN_DPAD_DOWN, PRESSED): -1} | {
    (EV_ABS, ABS_HAT0Y, -1): 1,
    (EV_ABS, ABS_HAT0Y, 1): -1,
}


class Stick(Enum):
    """The two of a pad."""

    MOVE = "move"
    TURN = "turn"


class Shape(NamedTuple):
    """Of the deflection, 0 to 1: what counts as rest, and how much of the curve is cubic."""

    deadzone: float
    expo: float


SHAPES = {Stick.MOVE: Shape(deadzone=0.1, expo=0.4), Stick.TURN: Shape(deadzone=0.1, expo=0.6)}
MOST_REST = 0.5  # a pad that calls more than that of its range flat has it wrong


def is_pad(device: Device) -> bool:
    """Whether it has a button of gamepads or joysticks at all."""
    return any(BTN_TRIGGER <= button <= BTN_LAST for button in device.buttons)


def layout_of(device: Device) -> Layout | None:
    """The first that fits; None: it is not known what its sticks and buttons are."""
    for row in LAYOUTS:
        layout = row.layout
        buttons, axes = (
            row.buttons | {layout.deadman, layout.stop},
            row.axes | {ABS_X, ABS_Y, layout.turn, layout.other},
        )
        if row.vendor in (None, device.vendor) and buttons <= device.buttons and axes <= device.axes:
            return layout
    return None


def what_it_has(device: Device) -> str:
    """Axes and buttons of a device, in words."""
    axes = ", ".join(AXIS_NAMES.get(axis, f"0x{axis:02x}") for axis in sorted(device.axes))
    buttons = ", ".join(f"0x{button:03x}" for button in sorted(device.buttons))
    return f"axes {axes or 'none'}; buttons {buttons or 'none'}"


def used(layout: Layout) -> tuple[int, int, int]:
    """Axes of which the ranges have to be known."""
    return (ABS_X, ABS_Y, layout.turn)


def wrong_ranges(axes: Mapping[int, Axis]) -> list[str]:
    """What no deflection can be told from, in words."""
    return [
        f"axis {AXIS_NAMES[code]} goes from {axis.minimum} to {axis.maximum}"
        for code, axis in axes.items()
        if axis.minimum >= axis.maximum
    ]


@dataclass(slots=True)
class Pad:
    """One pad; `axes`: the used ones by their codes, as they are when it is opened. Time is an argument, s."""

    layout: Layout
    axes: dict[int, Axis]
    why: str = ""  # what is held does not count, where that is so
    lost: bool = False  # events were lost: nothing but a stop is heard before `catch_up`
    _presses: int = 0
    _press: int | None = None
    _stop: bool = False
    _faster: int = 0
    _heard: float = 0.0

    def hear(self, events: Iterable[InputEvent], now: float) -> bool:
        """Takes in what happened; whether it should be sent at once, and not at the next command."""
        before = self._press
        for event in events:
            self._heard = now
            self._hear(event)
        return self._stop or (before is not None and self._press != before)

    def catch_up(self, axes: dict[int, Axis]) -> None:
        """Behind lost events: the axes as they are now."""
        self.axes, self.lost = axes, False

    def wish(self, now: float) -> Wish:
        """What it asks for now; a stop and steps of the scale once."""
        direction = self.direction
        if self._press is not None and direction != ZERO_TWIST and now - self._heard > SILENT_S:
            self._let_go(f"the pad has said nothing for {SILENT_S:g} s with a stick out")
        found = Wish(direction, self._press, stop=self._stop, faster=self._faster)
        self._stop, self._faster = False, 0
        return found

    @property
    def direction(self) -> Twist:
        """Of the sticks, whatever else is pressed: forward, left and counter-clockwise are positive."""
        x, y = self._deflection(ABS_X), self._deflection(ABS_Y)
        size = sqrt(x * x + y * y)
        share = self._shaped(size, Stick.MOVE, (ABS_X, ABS_Y)) / size if size > 0.0 else 0.0
        turn = self._deflection(self.layout.turn)
        turning = self._shaped(abs(turn), Stick.TURN, (self.layout.turn,))
        return Twist(0.0 - share * y, 0.0 - share * x, 0.0 - turning if turn > 0.0 else turning)

    def _hear(self, event: InputEvent) -> None:
        kind, code, value = event
        if kind == EV_KEY and code == self.layout.stop and value == PRESSED:  # true whatever was lost before it
            self._stop = True
        if self.lost or (kind == EV_SYN and code == SYN_DROPPED):
            self.lost = True
            self._let_go("events of the pad were lost")
            return
        self._faster += FASTER.get(event, 0)
        if kind == EV_ABS and code in self.axes:
            self.axes[code] = self.axes[code]._replace(value=value)
        elif kind == EV_KEY and code == self.layout.deadman and value == RELEASED:
            self._let_go("")
        elif kind == EV_KEY and code == self.layout.deadman and value == PRESSED:
            self._take_hold()

    def _take_hold(self) -> None:
        if self.direction != ZERO_TWIST:
            self._let_go("a stick was out when it was pressed")
            return
        self._presses += 1
        self._press, self.why = self._presses, ""

    def _let_go(self, why: str) -> None:
        self._press, self.why = None, why

    def _deflection(self, code: int) -> float:
        """From the middle of the range, which goes from -1 to 1."""
        axis = self.axes[code]
        middle = (axis.minimum + axis.maximum) / 2.0
        return (axis.value - middle) / (axis.maximum - middle)

    def _shaped(self, size: float, stick: Stick, codes: tuple[int, ...]) -> float:
        """0 within the zone of rest, 1 at full deflection and beyond it, as in a corner."""
        deadzone, expo = SHAPES[stick]
        flats = [2.0 * self.axes[code].flat / (self.axes[code].maximum - self.axes[code].minimum) for code in codes]
        rest = min(max(deadzone, *flats), MOST_REST)
        out = min(max((size - rest) / (1.0 - rest), 0.0), 1.0)
        return (1.0 - expo) * out + expo * out * out * out
