"""One CAN bus of the simulated world: arbitration by id and bit-time accounting, no errors of its own.

Frame lengths incl. interframe space after Davis et al., "Controller Area Network (CAN) schedulability analysis"
(2007); the typical stuffing is the mean over random payloads (115 of 135 bits for a full standard frame).
Those of CAN FD are counted field by field from the frame format of ISO 11898-1:2015.
"""

from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from heapq import heappop, heappush
from typing import NamedTuple

from drivers.contract import CanFrame
from replay.sim.controllers.contract import SECOND_NS, Emission

MAILBOXES = 3  # frames of one id that a device keeps while the bus is busy; the oldest goes. Source: ours


class Stuffing(Enum):
    """How many stuff bits a frame is taken to have."""

    WORST = "worst"
    TYPICAL = "typical"


class Sender(Enum):
    HOST = "host"
    DEVICE = "device"


class Arrival(NamedTuple):
    """A frame that left the wire."""

    end_ns: int
    frame: CanFrame
    sender: Sender


def frame_bits(*, extended: bool, length: int, stuffing: Stuffing) -> int:
    """Bits of one data frame on the wire; a remote frame counts as length 0."""
    fixed, stuffable = (67, 54) if extended else (47, 34)
    payload = 8 * length
    worst = (stuffable + payload - 1) // 4
    return fixed + payload + (worst if stuffing is Stuffing.WORST else (stuffable + payload) // 24)


def fd_frame_bits(*, extended: bool, length: int, stuffing: Stuffing) -> tuple[int, int]:
    """Bits of a CAN FD frame at the rate of arbitration, and those that the bit rate switch makes faster."""
    header = 36 if extended else 17  # start of frame to bit rate switch
    trailer = 13  # CRC delimiter, acknowledgement and its delimiter, end of frame, interframe space
    counted = 1 + 4 + 8 * length  # error state indicator, length code, data
    check = 4 + 21 + 7 if length > 16 else 4 + 17 + 6  # stuff count, CRC, fixed stuff bits
    if stuffing is Stuffing.WORST:
        first, all_stuff = (header - 1) // 4, (header + counted - 1) // 4
    else:
        first, all_stuff = header // 24, (header + counted) // 24
    return header + first + trailer, counted + all_stuff - first + check


class Wire:
    """Pending frames and the one on the wire. The host's frames go out in order, as from a socket's queue."""

    def __init__(
        self,
        bitrate: int,
        stuffing: Stuffing,
        deliver: Callable[[Arrival], Sequence[Emission]],
        *,
        data_bitrate: int | None = None,
    ) -> None:
        self._durations = {
            (extended, length): frame_bits(extended=extended, length=length, stuffing=stuffing) * SECOND_NS // bitrate
            for extended in (False, True)
            for length in range(9)
        }
        self._bitrate, self._stuffing, self._data_bitrate = bitrate, stuffing, data_bitrate or bitrate
        self._deliver = deliver
        self._upcoming: list[tuple[int, int, int, CanFrame]] = []  # heap by instant of readiness
        self._contenders: list[int] = []  # heap of priorities, one entry per frame in `_mailboxes`
        self._mailboxes: dict[int, deque[CanFrame]] = {}
        self._host: deque[Emission] = deque()
        self._in_flight: Arrival | None = None
        self._free_ns = 0
        self._count = 0
        self.busy_ns = 0  # total; the load is its growth over time
        self.host_may_send = True  # False: nobody acknowledges, so the host's frame never gets through

    @property
    def host_pending(self) -> int:
        return len(self._host)

    def offer(self, emission: Emission) -> None:
        """A device's frame."""
        self._count += 1
        frame = emission.frame
        heappush(self._upcoming, (emission.ready_ns, self._count, _priority(frame), frame))

    def offer_from_host(self, emission: Emission) -> None:
        self._host.append(emission)

    def forget_host(self) -> None:
        """Empty the host's queue; a frame already on the wire goes out."""
        self._host.clear()

    def run(self, until_ns: int) -> None:
        """Deliver every frame that ends by `until_ns`; replies take part at once."""
        while self._in_flight is not None or self._begin(until_ns):
            arrival = self._in_flight
            if arrival is None or arrival.end_ns > until_ns:
                return
            self._in_flight = None
            for reply in self._deliver(arrival):
                self.offer(reply)

    def _begin(self, until_ns: int) -> bool:
        """Put the most urgent ready frame on the wire; False: none that starts by `until_ns`."""
        start_ns = self._free_ns if self._contenders else max(self._free_ns, self._first_ready_ns(until_ns + 1))
        if start_ns > until_ns:
            return False
        upcoming, contenders = self._upcoming, self._contenders
        while upcoming and upcoming[0][0] <= start_ns:
            _, _, priority, frame = heappop(upcoming)
            self._contend(priority, frame)
        if self._host_wins(start_ns):
            frame, sender = self._host.popleft().frame, Sender.HOST
        else:
            frame, sender = self._mailboxes[heappop(contenders)].popleft(), Sender.DEVICE
        duration_ns = self._duration_ns(frame)
        self.busy_ns += duration_ns
        self._free_ns = start_ns + duration_ns
        self._in_flight = Arrival(self._free_ns, frame, sender)
        return True

    def _duration_ns(self, frame: CanFrame) -> int:
        if not frame.fd:
            return self._durations[frame.extended, 0 if frame.remote else len(frame.data)]
        nominal, fast = fd_frame_bits(extended=frame.extended, length=len(frame.data), stuffing=self._stuffing)
        rate = self._data_bitrate if frame.bit_rate_switch else self._bitrate
        return nominal * SECOND_NS // self._bitrate + fast * SECOND_NS // rate

    def _contend(self, priority: int, frame: CanFrame) -> None:
        mailbox = self._mailboxes.get(priority)
        if mailbox is None:
            mailbox = self._mailboxes[priority] = deque(maxlen=MAILBOXES)
        if len(mailbox) < MAILBOXES:
            heappush(self._contenders, priority)
        mailbox.append(frame)

    def _first_ready_ns(self, never_ns: int) -> int:
        ready_ns = self._upcoming[0][0] if self._upcoming else never_ns
        return min(ready_ns, self._host[0].ready_ns) if self._host and self.host_may_send else ready_ns

    def _host_wins(self, start_ns: int) -> bool:
        if not self._host or not self.host_may_send or self._host[0].ready_ns > start_ns:
            return False
        return not self._contenders or _priority(self._host[0].frame) < self._contenders[0]


def _priority(frame: CanFrame) -> int:
    """The arbitration field as a number: the smallest wins; standard before extended, data before remote."""
    if frame.extended:
        base, rest = frame.id >> 18, frame.id & 0x3FFFF
        return base << 21 | 0b11 << 19 | rest << 1 | frame.remote
    return frame.id << 21 | frame.remote << 20
