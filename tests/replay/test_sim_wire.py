"""One simulated CAN bus: frame lengths, arbitration, queues."""

from collections.abc import Sequence
from random import Random

import pytest

from drivers.contract import FD_LENGTHS, CanFrame
from gateway.core.examination import fd_frame_bits as core_fd_frame_bits
from replay.sim.controllers.contract import Emission
from replay.sim.wire import Arrival, Sender, Stuffing, Wire, fd_frame_bits, frame_bits

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


def stuffed(bits: str) -> int:
    """How many bits a sender puts in: one behind every five equal ones, which counts itself."""
    count, run, last = 0, 0, ""
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count, run, last = count + 1, 1, "10"[int(bit)]
    return count


def fd_bits(identifier: int, data: bytes, *, extended: bool) -> tuple[int, int]:
    """Of one frame, written out: start, id, (SRR, IDE, id), RRS, (IDE), FDF, res, BRS | ESI, DLC, data, ..."""
    code = FD_LENGTHS.index(len(data))
    ids = f"{identifier:029b}"
    header = f"0{ids[:11]}11{ids[11:]}0101" if extended else f"0{identifier:011b}00101"
    body = f"0{code:04b}" + "".join(f"{byte:08b}" for byte in data)
    first = stuffed(header)
    check = 4 + (21 + 7 if len(data) > 16 else 17 + 6)
    return len(header) + first + 1 + 2 + 7 + 3, len(body) + stuffed(header + body) - first + check


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("length", FD_LENGTHS)
def test_no_fd_frame_is_longer_than_the_longest(*, extended: bool, length: int) -> None:
    """Zeros, and ones and zeros in fours behind a first five, are the most stuffed; random ones are typical."""
    longest = fd_frame_bits(extended=extended, length=length, stuffing=Stuffing.WORST)
    assert longest == core_fd_frame_bits(length, extended=extended)
    chance = Random(length)
    ids = [0, 0x7FF, *(chance.getrandbits(29 if extended else 11) for _ in range(30))]
    worst = []
    for identifier in ids:
        for data in (bytes(length), b"\xff" * length, (b"\x0f\x87\xc3\xe1\xf0\x78\x3c\x1e" * 8)[:length]):
            bits = fd_bits(identifier, data, extended=extended)
            assert bits[0] <= longest[0]
            assert sum(bits) <= sum(longest)
            worst.append(sum(bits))
    assert max(worst) >= 0.85 * sum(longest)
    typical = fd_frame_bits(extended=extended, length=length, stuffing=Stuffing.TYPICAL)
    drawn = [fd_bits(chance.getrandbits(11), chance.randbytes(length), extended=extended) for _ in range(300)]
    assert sum(typical) == pytest.approx(sum(map(sum, drawn)) / 300, rel=0.04)


def test_the_data_of_an_fd_frame_go_at_the_faster_rate() -> None:
    """64 bytes: 17 + 4 + 13 bits at 1 Mbit/s, 5 + 512 + 129 + 32 at 8 Mbit/s, or all of them at 1."""
    for switch, end_ns in ((True, 34_000 + 84_750), (False, 34_000 + 678_000)):
        arrivals: list[Arrival] = []

        def deliver(arrival: Arrival, to: list[Arrival] = arrivals) -> Sequence[Emission]:
            to.append(arrival)
            return ()

        wire = Wire(1_000_000, Stuffing.WORST, deliver, data_bitrate=8_000_000)
        sent = CanFrame("can0", 1, bytes(64), fd=True, bit_rate_switch=switch)
        wire.offer(Emission(0, sent))
        wire.run(10 * MILLISECOND)
        assert [(arrival.end_ns, arrival.frame) for arrival in arrivals] == [(end_ns, sent)]


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
