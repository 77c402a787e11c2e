"""The CAN edge: python-can buses in, `CanFrame` and `BusEvent` out. Owned by the loop's thread; never blocks.

How this works
--------------
A frame that cannot be sent in its cycle is dropped and counted: stale setpoints must not pile up in a queue and drive
the robot once the cable is back. For the same reason the socket's send buffer is kept at about two cycles of frames.
A bus that fails (interface missing, down, deleted, bus-off, queue stuck, an adapter that raises whatever it likes) is
reported DOWN once, and UP when it works again: frames of a whole cycle could be sent if sending was what failed, else
any frame passes. A socket of a deleted interface stays dead for ever and is reopened every half second, one whose
interface is only down comes back by itself (measured). Whether the robot may move then is for the core to say. On
SocketCAN the kernel lets pass only what a driver wants to hear, and error frames: foreign traffic costs the loop
nothing.

SocketCAN answers at once. Any other adapter may hold its caller, so it is opened, written to and closed by a thread of
its own (`gateway.edges.can_thread`) and counts as down until it is open; the words of a failure come a cycle later.

Stamps are trusted of SocketCAN only: those of other adapters count from their own start, or drift; their frames get
the time of the cycle in which they are taken. A message that the bus cannot carry is dropped and counted, and so is
one of CAN FD on a bus without `fd`.
"""

import errno
import logging
import os
import socket
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

from drivers.contract import CanFrame, ReceiveFilter
from gateway.config import Bus, ConfigError, RobotConfig
from gateway.core.assembly import Robot, build
from gateway.edges.can_adapter import AdapterError, ask, epoch_ns, flaw, frame_of, message_of
from gateway.edges.can_errors import meanings
from gateway.edges.can_thread import AdapterThread
from gateway.edges.claims import Claims, InUseError
from gateway.edges.python_can import can
from gateway.types import BusEvent, BusEventKind

logger = logging.getLogger(__name__)

REOPEN_NS = 500_000_000
STUCK_CYCLES = 25  # cycles in a row in which not every frame could be sent: nobody acknowledges
MAX_FRAMES_PER_DRAIN = 512  # a flood must not hold the loop; the rest waits in the kernel ...
SHORTEST_FRAME_BITS = 47  # ... unless a full bus carries more in a period (slow loops): it would never be caught up
SHORTEST_FD_FRAME_BITS = 30  # those before and behind the part that a bit rate switch makes faster
SEND_BUFFER = 8192  # bytes; an skb of one CAN frame counts for about 800, so this holds about ten frames

_INTERFACES = Path("/proc/self/net/dev")  # of the network namespace of this process
_ENDS_BUS_OFF = (BusEventKind.RESTARTED, BusEventKind.ERROR_ACTIVE)


class BusEdge(Protocol):
    """What the service needs of the buses; the simulated bus answers the same calls."""

    def receive(self, now_ns: int) -> tuple[list[CanFrame], list[BusEvent]]:
        """Frames and events since the last call."""
        ...

    def send(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        """Send now or drop; failures are events of the next `receive`."""
        ...

    def close(self) -> None:
        """Release every bus."""
        ...


class CanBuses:
    """All buses of the robot file. One that cannot be opened yet is DOWN and tried again.

    Raises InUseError if another process commands the same motors, before anything is sent or opened; later, in
    `receive`, ConfigError for an interface that python-can does not know.
    """

    def __init__(self, config: RobotConfig) -> None:
        self._channels: dict[str, _Channel] = {}
        robot = build(config)
        try:
            for bus in config.bus:
                self._channels[bus.name] = _Channel(bus, robot, rate_hz=config.loop.rate)
        except InUseError:
            self.close()
            raise

    def receive(self, now_ns: int) -> tuple[list[CanFrame], list[BusEvent]]:
        """Frames and events of every bus since the last call."""
        frames: list[CanFrame] = []
        events: list[BusEvent] = []
        for channel in self._channels.values():
            channel.drain(frames, now_ns)
            events += channel.take_events()
        return frames, events

    def send(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        """Send each frame now or drop it."""
        if len(self._channels) == 1:
            for channel in self._channels.values():
                channel.send(frames, now_ns)
            return
        for name, channel in self._channels.items():
            channel.send([frame for frame in frames if frame.bus == name], now_ns)

    def close(self) -> None:
        """Close every bus and let others command its motors."""
        for channel in self._channels.values():
            channel.finish()
            channel.claims.release()


class _Channel:
    """One python-can bus with its failures."""

    def __init__(self, config: Bus, robot: Robot, *, rate_hz: float) -> None:
        mine = [group.driver for group in robot.groups if group.bus == config.name]
        commanded = {frame.id for driver in mine for frame in driver.coast_frames()}
        self.claims = Claims(config.interface, config.channel, commanded)
        self._config = config
        shortest = SHORTEST_FD_FRAME_BITS if config.fd else SHORTEST_FRAME_BITS
        self._most_frames = max(MAX_FRAMES_PER_DRAIN, round(2.0 * config.bitrate / shortest / rate_hz))
        self._kernel_stamps = config.interface == "socketcan"
        self._filters = robot.receive_filters(config.name)
        self._bus: can.BusABC | None = None
        self._thread = None if config.interface == "socketcan" else AdapterThread(config.name)
        self._opening = False  # and so long down, for no other reason
        self._events: list[BusEvent] = []
        self._down = False
        self._bus_off = False
        self._unsent = False  # frames were dropped and no whole cycle of them could be sent since
        self._retry_ns = 0
        self._stuck = 0
        self._stamp_ns = 0

    def _open(self) -> None:
        """Open a SocketCAN interface."""
        _check_exists(self._config.channel)  # python-can would leak its socket on a missing interface
        bus = self._connected()
        self._bus = bus
        raw = getattr(bus, "socket", None)
        if isinstance(raw, socket.socket):
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        # Only here: elsewhere python-can filters in Python, and error frames away.
        bus.set_filters([_can_filter(wanted) for wanted in self._filters])

    def _connected(self) -> can.BusABC:
        """The interface, open; bit rates matter only where python-can sets them (not on socketcan)."""
        config = self._config
        more: dict[str, Any] = {"fd": True} if config.fd else {}  # not every adapter takes it
        if config.data_bitrate is not None:
            more["data_bitrate"] = config.data_bitrate
        return can.Bus(interface=config.interface, channel=config.channel, bitrate=config.bitrate, **more)

    def _open_elsewhere(self, thread: AdapterThread, now_ns: int) -> None:
        """Begin to open, or take over what is open by now. Raises AdapterError."""
        self._bus = thread.opened()
        if self._bus is None and thread.free and now_ns >= self._retry_ns:
            self._retry_ns = now_ns + REOPEN_NS
            thread.open(self._connected)
            if not self._down:
                self._mark_down(f"{self._config.interface} {self._config.channel} is being opened")
                self._opening = True

    def finish(self) -> None:
        """Close for good; of what was sent, the last is still written."""
        if self._thread is not None:
            self._thread.finish()
        self.close()

    def close(self) -> None:
        bus, self._bus = self._bus, None
        if self._thread is not None:
            self._thread.close()
        elif bus is not None:
            try:
                ask(bus.shutdown)
            except AdapterError as error:
                logger.debug("closing %s: %s", self._config.name, error)

    def take_events(self) -> list[BusEvent]:
        events, self._events = self._events, []
        return events

    def drain(self, frames: list[CanFrame], now_ns: int) -> None:
        """Append what arrived, oldest first, stamped in the loop's clock."""
        if self._bus is None and not self._reopen(now_ns):
            return
        offset_ns = time.clock_gettime_ns(time.CLOCK_REALTIME) - time.monotonic_ns()
        try:
            for _ in range(self._most_frames):
                message = ask(self._bus.recv, 0) if self._bus else None
                if message is None:
                    return
                problem = ask(flaw, message, fd=self._config.fd)
                if problem is not None:
                    self._event(BusEventKind.RX_MALFORMED, f"dropped: {problem}")
                elif message.is_error_frame:
                    self._error_frame(message)
                else:
                    self._bus_off = self._bus_off and not message.is_rx  # a controller that is bus-off hears nobody
                    self._works()
                    stamp_ns = self._stamped(message, offset_ns, now_ns)
                    frames.append(frame_of(message, bus=self._config.name, received_ns=stamp_ns))
        except AdapterError as error:
            self._fail("receive", error, now_ns)

    def _stamped(self, message: can.Message, offset_ns: int, now_ns: int) -> int:
        """When a message arrived: never after now, and never before the one before it."""
        wall_ns = epoch_ns(message) if self._kernel_stamps else None
        arrived_ns = now_ns if wall_ns is None else min(wall_ns - offset_ns, now_ns)
        self._stamp_ns = max(self._stamp_ns, arrived_ns)
        return self._stamp_ns

    def send(self, frames: Iterable[CanFrame], now_ns: int) -> None:
        """Send in order; after the first failure the rest of the cycle is dropped."""
        bus, pending = self._bus, list(frames)
        if not pending:
            return
        if bus is None:
            self._unsent = True
            self._event(BusEventKind.TX_DROPPED, "bus is down", len(pending))
            return
        if self._thread is not None:
            self._hand_over(self._thread, pending, now_ns)
            return
        for index, frame in enumerate(pending):
            try:
                ask(bus.send, message_of(frame), timeout=0)
            except AdapterError as error:
                self._dropped(error, len(pending) - index, now_ns)
                return
        self._stuck = 0
        self._unsent = False
        self._works()

    def _hand_over(self, thread: AdapterThread, frames: Sequence[CanFrame], now_ns: int) -> None:
        """The same with a slow adapter: only once frames were really written does it work."""
        try:
            thread.send([message_of(frame) for frame in frames])
        except AdapterError as error:
            self._dropped(error, len(frames), now_ns)
            return
        if thread.works:
            self._stuck = 0
            self._unsent = False
            self._works()

    def _dropped(self, error: AdapterError, number: int, now_ns: int) -> None:
        self._event(BusEventKind.TX_DROPPED, f"not sent: {error}", number)
        self._unsent = True
        self._stuck += 1
        if not _is_full(error):
            self._fail("send", error, now_ns)
        elif self._stuck >= STUCK_CYCLES:
            why = "nobody acknowledges" if self._thread is None else "a write does not return"
            self._mark_down(f"send queue full for {STUCK_CYCLES} cycles: {why}")

    def _fail(self, action: str, error: AdapterError, now_ns: int) -> None:
        self._bus_off = False
        if error.number != errno.ENETDOWN:
            self.close()
            self._retry_ns = now_ns + REOPEN_NS
        self._mark_down(f"{action}: {error}")

    def _reopen(self, now_ns: int) -> bool:
        try:
            if self._thread is not None:
                self._open_elsewhere(self._thread, now_ns)
            elif now_ns >= self._retry_ns:
                self._retry_ns = now_ns + REOPEN_NS
                ask(self._open)
        except AdapterError as error:
            self.close()
            unknown = isinstance(error.__cause__, can.CanInterfaceNotImplementedError)
            if unknown and self._config.interface not in can.VALID_INTERFACES:
                raise ConfigError("robot file", [f"bus {self._config.name}: interface: {error}"]) from None
            self._mark_down(f"{self._config.interface} {self._config.channel} cannot be opened: {error}")
        return self._bus is not None

    def _error_frame(self, message: can.Message) -> None:
        for _, _, kind, text in meanings(message.arbitration_id, bytes(message.data)):
            self._event(kind, text)
            if kind is BusEventKind.BUS_OFF:
                self._bus_off = True
                self._mark_down(text)
            elif kind in _ENDS_BUS_OFF:
                self._bus_off = False

    def _mark_down(self, reason: str) -> None:
        if not self._down or self._opening:
            self._down, self._opening = True, False
            self._event(BusEventKind.DOWN, reason)

    def _works(self) -> None:
        """A frame has passed; while the controller is bus-off that is only the kernel's queue taking it."""
        if self._down and not self._bus_off and not self._unsent:
            self._down = self._opening = False
            self._event(BusEventKind.UP, "works again")

    def _event(self, kind: BusEventKind, text: str, occurrences: int = 1) -> None:
        """Note it; a shower of equal error frames becomes one event with a count."""
        last = self._events[-1] if self._events else None
        if last is not None and (last.kind, last.text) == (kind, text):
            self._events[-1] = last._replace(occurrences=last.occurrences + occurrences)
            return
        self._events.append(BusEvent(self._config.name, kind, occurrences, text))


def interface_exists(channel: str) -> bool:
    """Whether this network interface is there now.

    Read from proc, because asking by name makes the kernel look for a module of that name if one may load modules, and
    that held the loop up for seconds (measured).
    """
    lines = _INTERFACES.read_text(encoding="utf-8").splitlines()
    return any(line.partition(":")[0].strip() == channel for line in lines)


def _check_exists(channel: str) -> None:
    if not interface_exists(channel):
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV), channel)


def _can_filter(wanted: ReceiveFilter) -> can.typechecking.CanFilter:
    return {"can_id": wanted.id, "can_mask": wanted.mask, "extended": wanted.extended}


def _is_full(error: AdapterError) -> bool:
    """A full queue passes; python-can does not always keep the errno, so its words are asked too (python-can #2005)."""
    return error.number in (errno.ENOBUFS, errno.EAGAIN) or "buffer full" in str(error).lower()
