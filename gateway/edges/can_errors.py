"""What SocketCAN's error frames mean: linux/can/error.h, as one table."""

from typing import NamedTuple

from gateway.types import BusEventKind


class ErrorMeaning(NamedTuple):
    """A bit of the error class, or with `controller` one of the controller's state in the second data byte."""

    bit: int
    controller: bool
    kind: BusEventKind
    text: str


_CLASS_CONTROLLER = 0x004
_MEANINGS = (
    ErrorMeaning(0x040, False, BusEventKind.BUS_OFF, "controller is bus-off: short circuit or wrong bit rate"),
    ErrorMeaning(0x100, False, BusEventKind.RESTARTED, "controller restarted"),
    ErrorMeaning(
        0x30, True, BusEventKind.ERROR_PASSIVE, "controller is error-passive: nobody acknowledges, cable or bit rate"
    ),
    ErrorMeaning(0x40, True, BusEventKind.ERROR_ACTIVE, "controller is error-active again"),
    ErrorMeaning(0x01, True, BusEventKind.RX_OVERFLOW, "receive buffer of the controller overflowed"),
)


def meanings(classes: int, data: bytes) -> list[ErrorMeaning]:
    """Everything that one error frame says, in the order of the table."""
    state = data[1] if classes & _CLASS_CONTROLLER and len(data) > 1 else 0
    return [meaning for meaning in _MEANINGS if meaning.bit & (state if meaning.controller else classes)]
