"""python-can and its adapters are foreign code: what they raise and what they hand over is met here, once.

How this works
--------------
An adapter may raise anything: a corrupt serial line ends in ValueError, TypeError, OverflowError or struct.error in
some of them, an unplugged one in whatever its vendor's library throws. Every call goes through `ask`, which knows one
failure only, so that a bus can break but not the process. What it hands over is checked by `flaw` before it is used.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, ParamSpec, TypeVar

from drivers.contract import FD_LENGTHS, CanFrame
from gateway.edges.python_can import can

MAX_LENGTH = 8  # bytes of a classic frame
MAX_STANDARD_ID, MAX_EXTENDED_ID = 0x7FF, 0x1FFF_FFFF
MAX_EPOCH_S = 1e11  # the year 5138: no clock says that

_EXPECTED = (can.CanError, OSError)  # their words need no name of a Python class before them
_P = ParamSpec("_P")
_T = TypeVar("_T")


class AdapterError(Exception):
    """A failure of an adapter in its own words; `number` is its errno where it tells one."""

    def __init__(self, error: Exception) -> None:
        words = str(error) or type(error).__name__
        super().__init__(words if isinstance(error, _EXPECTED) else f"{type(error).__name__}: {words}")
        self.number = _errno(error)


def ask(call: Callable[_P, _T], *args: _P.args, **kwargs: _P.kwargs) -> _T:
    """The answer of an adapter. Raises AdapterError for whatever it raises."""
    try:
        return call(*args, **kwargs)
    except Exception as error:
        # No narrower class would do: nobody knows what an adapter may raise, and none of it may end the drive.
        raise AdapterError(error) from error


def flaw(message: can.Message, *, fd: bool = False) -> str | None:
    """What is wrong with a received message; None for one that the bus, classic unless `fd`, can carry."""
    identifier, data = message.arbitration_id, message.data
    highest = MAX_EXTENDED_ID if message.is_extended_id or message.is_error_frame else MAX_STANDARD_ID
    if message.is_fd and (not fd or message.is_remote_frame):
        return "a remote frame of CAN FD" if fd else "a CAN FD frame on a classic bus"
    if not isinstance(identifier, int) or not 0 <= identifier <= highest:
        return f"id {identifier!r} is none"
    lengths = FD_LENGTHS if message.is_fd else range(MAX_LENGTH + 1)
    if not isinstance(data, bytes | bytearray) or len(data) not in lengths:
        allowed = "0 to 8, 12, 16, 20, 24, 32, 48 or 64" if message.is_fd else f"0 to {MAX_LENGTH}"
        return f"data {data!r} of id 0x{identifier:X}: must be {allowed} bytes"
    if not message.is_remote_frame and len(data) != message.dlc:
        return f"length {message.dlc!r} of id 0x{identifier:X} with {len(data)} bytes of data"
    return None


def frame_of(message: can.Message, *, bus: str, received_ns: int | None) -> CanFrame:
    """A message without flaw as a frame."""
    remote = bool(message.is_remote_frame)
    data = b"" if remote else bytes(message.data)
    fd = bool(message.is_fd)
    switch = fd and bool(message.bitrate_switch)
    return CanFrame(bus, message.arbitration_id, data, bool(message.is_extended_id), remote, received_ns, fd, switch)


def message_of(frame: CanFrame) -> can.Message:
    """A frame as python-can wants it."""
    return can.Message(
        arbitration_id=frame.id,
        data=frame.data,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_fd=frame.fd,
        bitrate_switch=frame.bit_rate_switch,
    )


def epoch_ns(message: can.Message) -> int | None:
    """The stamp of a message whose adapter counts from the epoch; None if it is no time."""
    stamp = message.timestamp
    return round(stamp * 1e9) if isinstance(stamp, int | float) and 0.0 <= stamp < MAX_EPOCH_S else None


@contextmanager
def opened(*, interface: str, channel: str, fd: bool = False, bitrate: int | None = None) -> Iterator[can.BusABC]:
    """A bus for a while. Raises AdapterError if it cannot be opened; closing may fail as it likes."""
    more: dict[str, Any] = {"fd": True} if fd else {}  # not every adapter takes it
    if bitrate is not None:
        more["bitrate"] = bitrate
    bus = ask(can.Bus, interface=interface, channel=channel, **more)
    try:
        yield bus
    finally:
        with suppress(AdapterError):
            ask(bus.shutdown)


def _errno(error: Exception) -> int | None:
    """A CanOperationError carries it as error_code, an OSError as errno."""
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    return number if isinstance(number, int) else None
