"""The motors' end of a real CAN interface: a python-can bus that survives whatever happens to the interface."""

import errno
import logging
import time
from collections.abc import Callable, Iterable, Sequence

from gateway.config import Motor
from gateway.edges.can_bus import interface_exists
from gateway.edges.python_can import can

logger = logging.getLogger(__name__)

REOPEN_NS = 100_000_000

_ODRIVE_NODE_SHIFT, _ODRIVE_NODE_MASK = 5, 0x7E0  # CANSimple: node id in the upper six bits
_DJI_COMMANDS = tuple((at, 0x7FF, False) for at in (0x200, 0x1FF, 0x2FF, 0x1FE, 0x2FE))  # C610, p. 8; GM6020: taproot
_VESC_MASK = 0x1FFF00FF  # documentation/comm_can.md: VESC id in the lowest byte, command in the next

# What the controllers' own hardware filters let pass; without them foreign traffic would stall the world.
HEARD: dict[str, Callable[[int], Sequence[tuple[int, int, bool]]]] = {  # id, mask, whether the id is extended
    "odrive": lambda node: ((node << _ODRIVE_NODE_SHIFT, _ODRIVE_NODE_MASK, False),),
    "dji": lambda _: _DJI_COMMANDS,
    "vesc": lambda node: ((node, _VESC_MASK, True),),
}


class MotorsInterface(can.BusABC):
    """SocketCAN, opened when it can be and reopened after the interface was deleted; raises CanError in between."""

    def __init__(self, channel: str, motors: Iterable[Motor], *, fd: bool = False) -> None:
        self._fd = fd
        self._filters_wanted = [wanted for motor in motors for wanted in _heard(motor)]
        self._channel = channel
        self._bus: can.BusABC | None = None
        self._retry_ns = 0
        super().__init__(channel=channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send, or raise CanError."""
        bus = self._open()
        try:
            bus.send(msg, timeout)
        except can.CanOperationError as error:
            self._forget_if_gone(error)
            raise

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        bus = self._open()
        try:
            return bus.recv(timeout), True
        except can.CanOperationError as error:
            self._forget_if_gone(error)
            raise

    def shutdown(self) -> None:
        """Close the interface."""
        super().shutdown()
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def _open(self) -> can.BusABC:
        if self._bus is not None:
            return self._bus
        now_ns = time.monotonic_ns()
        if now_ns >= self._retry_ns:
            self._retry_ns = now_ns + REOPEN_NS
            if interface_exists(self._channel):  # python-can would leak its socket
                self._bus = can.Bus(
                    interface="socketcan", channel=self._channel, can_filters=self._filters_wanted, fd=self._fd
                )
                return self._bus
        raise can.CanOperationError(f"{self._channel} is not there")

    def _forget_if_gone(self, error: can.CanOperationError) -> None:
        """A socket whose interface was deleted is dead for ever; a full queue or a link that is down passes."""
        if error.error_code in (errno.ENODEV, errno.ENXIO) and self._bus is not None:
            self._bus.shutdown()
            self._bus = None


def _heard(motor: Motor) -> list[can.typechecking.CanFilter]:
    heard = HEARD[motor.driver](motor.id)
    return [{"can_id": identifier, "can_mask": mask, "extended": extended} for identifier, mask, extended in heard]
