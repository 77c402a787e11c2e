"""A bus that is only listened to, whatever is on it: every frame and error frame; a few questions are all it sends."""

import errno
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from drivers.contract import CanFrame
from gateway.edges.can_adapter import AdapterError, ask, epoch_ns, flaw, frame_of, message_of, opened
from gateway.edges.can_bus import interface_exists
from gateway.edges.can_errors import meanings
from gateway.edges.python_can import can

WAIT_S = 0.02
ASK_GAP_S = 0.002  # between two questions: a burst would fill the queue of an interface


class Place(NamedTuple):
    """A bus as python-can knows it."""

    interface: str
    channel: str
    bitrate: int | None = None  # only where python-can sets it: of SocketCAN the link has it

    @property
    def name(self) -> str:
        return self.channel


def refuse_where_absent(place: Place) -> None:
    """Raises AdapterError where this computer has no such interface; of others than SocketCAN only opening tells."""
    if place.interface == "socketcan" and not interface_exists(place.channel):
        with _named(place):
            raise AdapterError(OSError(f"{os.strerror(errno.ENODEV)}; `ip -brief link` shows those that there are"))


@contextmanager
def _named(place: Place) -> Iterator[None]:
    """What fails says of which bus it is."""
    try:
        yield
    except AdapterError as error:
        error.args = (f"{place.interface} {place.channel}: {error}",)
        raise


def listen(
    place: Place,
    seconds: float,
    take: Callable[[CanFrame], None],
    *,
    going_on: Callable[[], bool] = lambda: True,
    questions: Callable[[float], Sequence[CanFrame]] = lambda _: (),
) -> dict[str, int]:
    """Hands over every frame for so many seconds; error frames by meaning, counted. Raises AdapterError.

    `questions`: what to send now, asked again and again with the seconds gone. `going_on`: False ends it sooner.
    """
    refuse_where_absent(place)
    errors: dict[str, int] = {}
    with _named(place), opened(interface=place.interface, channel=place.channel, bitrate=place.bitrate) as bus:
        begin_ns = time.monotonic_ns()
        while going_on() and (gone := (time.monotonic_ns() - begin_ns) * 1e-9) < seconds:
            for frame in questions(gone):
                ask(bus.send, message_of(frame), timeout=WAIT_S)
                time.sleep(ASK_GAP_S)
            message = ask(bus.recv, WAIT_S)
            if message is None or ask(flaw, message) is not None:
                continue
            if message.is_error_frame:
                for meaning in meanings(message.arbitration_id, bytes(message.data)):
                    errors[meaning.text] = errors.get(meaning.text, 0) + 1
                continue
            take(frame_of(message, bus=place.name, received_ns=_stamp(place, message)))
    return errors


def _stamp(place: Place, message: can.Message) -> int:
    """CLOCK_MONOTONIC; those of other adapters than SocketCAN mean something else, see `gateway.edges.can_bus`."""
    now_ns = time.monotonic_ns()
    wall_ns = epoch_ns(message) if place.interface == "socketcan" else None
    if wall_ns is None:
        return now_ns
    return min(now_ns, wall_ns - (time.clock_gettime_ns(time.CLOCK_REALTIME) - now_ns))
