"""One simulated CAN bus: frame lengths, arbitration, queues."""

from collections.abc import Sequence

import pytest

from drivers.contract import CanFrame
from replay.sim.controllers.contract import Emission
from replay.sim.wire import Arrival, Sender, Stuffing, Wire, frame_bits

MILLISECOND = 1_000_000


@pytest.mark.parametrize(
    ("extended", "length", "stuffing", "bits"),
    [
        (False, 8, Stuffing.WORST, 135),
        (False, 8, Stuffing.TYPICAL, 115),
        (True, 8, Stuffing.WORST, 160),
        (True, 8, Stuffing.TYPICAL, 135),
        (False, 0, Stuffing.WORST, 55),
        (False, 1, Stuffing.WORST, 65),
        (False, 6, Stuffing.WORST, 115),
        (True, 4, Stuffing.WORST, 120),
    ],
)
def test_frame_lengths(*, extended: bool, length: int, stuffing: Stuffing, bits: int) -> None:
    assert frame_bits(extended=extended, length=length, stuffing=stuffing) == bits


class Log:
    """A wire that writes down what leaves it."""

    def __init__(self, bitrate: int = 1_000_000) -> None:
        self.arrivals: list[Arrival] = []
        self.wire = Wire(bitrate, Stuffing.WORST, self._deliver)

    def _deliver(self, arrival: Arrival) -> Sequence[Emission]:
        self.arrivals.append(arrival)
        return ()

    @property
    def ids(self) -> list[int]:
        return [arrival.frame.id for arrival in self.arrivals]


def frame(identifier: int, *, extended: bool = False, remote: bool = False, data: bytes = bytes(8)) -> CanFrame:
    return CanFrame("can0", identifier, b"" if remote else data, extended=extended, remote=remote)


def test_lowest_id_wins_and_frames_follow_back_to_back() -> None:
    log = Log()
    for identifier in (0x203, 0x201, 0x204):
        log.wire.offer(Emission(1000, frame(identifier)))
    log.wire.offer_from_host(Emission(1000, frame(0x202)))
    log.wire.run(MILLISECOND)
    assert log.ids == [0x201, 0x202, 0x203, 0x204]
    assert [arrival.end_ns for arrival in log.arrivals] == [1000 + 135_000 * n for n in (1, 2, 3, 4)]
    assert log.arrivals[1].sender is Sender.HOST


def test_a_frame_on_the_wire_is_not_interrupted() -> None:
    log = Log()
    log.wire.offer(Emission(0, frame(0x400)))
    log.wire.offer(Emission(1, frame(0x500)))
    log.wire.offer(Emission(2, frame(0x100)))
    log.wire.run(MILLISECOND)
    assert log.ids == [0x400, 0x100, 0x500]


def test_standard_before_extended_and_data_before_remote() -> None:
    log = Log()
    base = 0x123
    log.wire.offer(Emission(0, frame(base << 18 | 5, extended=True)))
    log.wire.offer(Emission(0, frame(base, remote=True)))
    log.wire.offer(Emission(0, frame(base)))
    log.wire.offer(Emission(0, frame((base - 1) << 18 | 0x3FFFF, extended=True)))
    log.wire.run(MILLISECOND)
    kinds = [(arrival.frame.extended, arrival.frame.remote) for arrival in log.arrivals]
    assert kinds == [(True, False), (False, False), (False, True), (True, False)]


def test_host_queue_keeps_its_order() -> None:
    log = Log()
    for identifier in (0x300, 0x100, 0x200):
        log.wire.offer_from_host(Emission(0, frame(identifier)))
    log.wire.offer(Emission(0, frame(0x250)))
    log.wire.run(MILLISECOND)
    assert log.ids == [0x250, 0x300, 0x100, 0x200]


def test_frame_that_does_not_end_in_time_comes_later() -> None:
    log = Log(bitrate=250_000)
    log.wire.offer(Emission(0, frame(0x100)))
    log.wire.run(539_999)
    assert log.ids == []
    log.wire.run(540_000)
    assert log.ids == [0x100]


def test_busy_device_keeps_only_its_newest_frames() -> None:
    log = Log()
    log.wire.offer(Emission(0, frame(0x001)))
    for number in range(1, 6):
        log.wire.offer(Emission(number, frame(0x300, data=bytes([number]))))
    log.wire.run(MILLISECOND)
    assert [arrival.frame.data[0] for arrival in log.arrivals] == [0, 3, 4, 5]
