"""One simulated bus as the host sees it: the wire, the devices on it, what waits for the host, and its faults."""

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from random import Random

from drivers.contract import CanFrame
from gateway.config import Bus
from gateway.types import BusEvent, BusEventKind
from replay.sim.controllers.contract import SECOND_NS, BusDevice, Emission
from replay.sim.wire import Arrival, Sender, Stuffing, Wire

HOST_QUEUE = 32  # frames; a small txqueuelen, so that a dead bus is noticed instead of storing old setpoints


class Segment:
    """State owner of one bus; `run` is called with instants that never go back."""

    def __init__(self, bus: Bus, devices: Sequence[BusDevice], stuffing: Stuffing) -> None:
        self._name = bus.name
        self._devices = tuple(devices)
        self._wire = Wire(bus.bitrate, stuffing, self._deliver, data_bitrate=bus.data_bitrate)
        self._frames: list[CanFrame] = []  # in order of their stamps
        self._delayed: deque[tuple[int, CanFrame]] = deque()  # of the host, on their way to the bus
        self.delay_ns = 0  # of every frame between host and bus
        self._events: list[BusEvent] = []
        self._dropped = 0  # not sent since the last take_events
        self._drop_received = self._drop_sent = 0.0
        self._random = Random(0)
        self._double = 0.0
        self._doubling = Random(0)
        self._up = True
        self._passive = False
        self._foreign: CanFrame | None = None
        self._foreign_period_ns = 0
        self._foreign_due_ns: int | None = None

    @property
    def busy_ns(self) -> int:
        return self._wire.busy_ns

    def run(self, until_ns: int) -> None:
        """Let devices and host use the wire until then."""
        wire = self._wire
        for device in self._devices:
            for emission in device.poll(until_ns):
                wire.offer(emission)
        if self._foreign is not None:
            self._offer_foreign(self._foreign, until_ns)
        while self._delayed and self._delayed[0][0] <= until_ns:
            wire.offer_from_host(Emission(*self._delayed.popleft()))
        self._watch_acknowledgement()
        wire.run(until_ns)

    def send(self, frame: CanFrame, now_ns: int) -> None:
        """Queue a frame of the host, or count it as dropped."""
        if not self._up or self._wire.host_pending >= HOST_QUEUE:
            self._dropped += 1
            return
        if self.delay_ns or self._delayed:
            overtaken_ns = self._delayed[-1][0] if self._delayed else 0
            self._delayed.append((max(now_ns + self.delay_ns, overtaken_ns), frame))
        else:
            self._wire.offer_from_host(Emission(now_ns, frame))

    def take_frames(self, now_ns: int) -> list[CanFrame]:
        """What reached the host by now."""
        frames, self._frames = self._frames, []
        if frames and _stamp(frames[-1]) > now_ns:
            here = bisect_right(frames, now_ns, key=_stamp)
            frames, self._frames = frames[:here], frames[here:]
        return frames

    def reopen(self, now_ns: int) -> None:
        """A new socket: what waited in the old one is gone, what is still on its way is not."""
        self.take_frames(now_ns)
        self._events.clear()
        self._dropped = 0
        if not self._up:
            self._tell(BusEventKind.DOWN, "Network is down")

    def take_events(self) -> list[BusEvent]:
        events, self._events = self._events, []
        if self._dropped:
            reason = "No buffer space available" if self._up else "Network is down"
            events.append(BusEvent(self._name, BusEventKind.TX_DROPPED, self._dropped, reason))
            self._dropped = 0
        return events

    def drop(self, *, received: float, sent: float, random: Random) -> None:
        """Lose these fractions of the frames, after their wire time."""
        self._drop_received, self._drop_sent, self._random = received, sent, random

    def double(self, fraction: float, random: Random) -> None:
        """Deliver this fraction of the frames twice, as after an acknowledgement that was lost."""
        self._double, self._doubling = fraction, random

    def fail(self) -> None:
        """The host's interface goes down; the devices talk on, unheard."""
        if self._up:
            self._up = False
            self._wire.forget_host()
            self._delayed.clear()
            self._tell(BusEventKind.DOWN, "Network is down")

    def restore(self) -> None:
        if not self._up:
            self._up = True
            self._tell(BusEventKind.UP, "interface is up")

    def connect(self, device: BusDevice) -> None:
        """One more device on the bus."""
        self._devices = (*self._devices, device)

    def disconnect(self, device: BusDevice) -> None:
        """One less."""
        self._devices = tuple(one for one in self._devices if one is not device)

    def babble(self, frame: CanFrame, *, rate_hz: float) -> None:
        """Somebody else sends this frame at this rate, heard by host and devices; rate 0 ends it."""
        self._foreign = frame if rate_hz > 0.0 else None
        self._foreign_period_ns = round(SECOND_NS / rate_hz) if rate_hz > 0.0 else 0
        self._foreign_due_ns = None

    def _offer_foreign(self, frame: CanFrame, until_ns: int) -> None:
        due_ns = until_ns if self._foreign_due_ns is None else self._foreign_due_ns
        while due_ns <= until_ns:
            self._wire.offer(Emission(due_ns, frame))
            due_ns += self._foreign_period_ns
        self._foreign_due_ns = due_ns

    def _watch_acknowledgement(self) -> None:
        """A lone host never gets a frame through: the queue fills, the controller goes error-passive."""
        heard = self._foreign is not None or any(device.acknowledges for device in self._devices)
        self._wire.host_may_send = heard
        passive = not heard and self._wire.host_pending > 0
        if passive and not self._passive:
            self._tell(BusEventKind.ERROR_PASSIVE, "no acknowledgement received")
        if heard and self._passive:
            self._tell(BusEventKind.ERROR_ACTIVE, "back to error active")
        self._passive = passive or (self._passive and not heard)

    def _deliver(self, arrival: Arrival) -> Sequence[Emission]:
        """Hand a frame that left the wire to whoever is to hear it; the devices' replies."""
        end_ns, frame, sender = arrival
        if sender is Sender.HOST:
            lost = self._drop_sent > 0.0 and self._random.random() < self._drop_sent
            return () if lost else [one for _ in range(self._times()) for one in self._to_devices(frame, end_ns)]
        if self._up and not (self._drop_received > 0.0 and self._random.random() < self._drop_received):
            stamp_ns = end_ns + self.delay_ns
            if self._frames:
                stamp_ns = max(stamp_ns, _stamp(self._frames[-1]))
            self._frames += [frame._replace(bus=self._name, received_ns=stamp_ns)] * self._times()
        return self._to_devices(frame, end_ns) if frame is self._foreign else ()

    def _times(self) -> int:
        return 2 if self._double > 0.0 and self._doubling.random() < self._double else 1

    def _to_devices(self, frame: CanFrame, end_ns: int) -> list[Emission]:
        return [reply for device in self._devices for reply in device.receive(frame, end_ns)]

    def _tell(self, kind: BusEventKind, text: str) -> None:
        self._events.append(BusEvent(self._name, kind, 1, text))


def _stamp(frame: CanFrame) -> int:
    return frame.received_ns or 0
