"""The simulated buses: arbitration, stamps, load, faults, and the whole robot behind them."""

from collections.abc import Sequence
from pathlib import Path
from struct import pack

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.contract import CanFrame
from gateway.config import load
from gateway.types import BusEvent, BusEventKind
from replay.sim.attached_bus import HOST_QUEUE
from replay.sim.bus import SimulatedBus
from replay.sim.controllers.dji import SimulatedDji
from replay.sim.controllers.odrive import SimulatedODrive
from replay.sim.wire import Stuffing

ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
OMNI = load(ROBOTS / "omni4.toml")[0]
MOBY = load(ROBOTS / "moby.toml")[0]
MILLISECOND = 1_000_000
START = 123_456_789_012_345
ZERO = CanFrame("can0", 0x200, bytes(8))


def odrive(bus: SimulatedBus, name: str) -> SimulatedODrive:
    device = bus.robot.devices[name]
    assert isinstance(device, SimulatedODrive)
    return device


def dji(bus: SimulatedBus, name: str) -> SimulatedDji:
    device = bus.robot.devices[name]
    assert isinstance(device, SimulatedDji)
    return device


def drive(
    bus: SimulatedBus,
    cycles: int,
    frames: Sequence[CanFrame] = (),
    *,
    start_ns: int = START,
    period_ns: int = 4_000_000,
) -> tuple[list[CanFrame], list[BusEvent]]:
    """Run cycles of receive and send; everything that arrived and happened."""
    received: list[CanFrame] = []
    events: list[BusEvent] = []
    for cycle in range(cycles):
        now_ns = start_ns + cycle * period_ns
        arrived, happened = bus.receive(now_ns)
        assert all(frame.received_ns is not None and frame.received_ns <= now_ns for frame in arrived)
        received += arrived
        events += happened
        bus.send(frames, now_ns)
    return received, events


def stamps(frames: Sequence[CanFrame]) -> list[int]:
    return [frame.received_ns for frame in frames if frame.received_ns is not None]


# -- time -------------------------------------------------------------------------------------------------------------


def test_first_receive_is_the_origin() -> None:
    bus = SimulatedBus(OMNI)
    assert bus.receive(START) == ([], [])
    assert bus.robot.truth.time_ns == START
    frames, _ = bus.receive(START + 10 * MILLISECOND)
    assert len(frames) == pytest.approx(40, abs=4)


@settings(max_examples=20, deadline=None)
@given(gaps=st.lists(st.integers(0, 3_000_000), max_size=40))
def test_frames_do_not_depend_on_when_they_are_fetched(gaps: list[int]) -> None:
    bus, other = SimulatedBus(MOBY), SimulatedBus(MOBY)
    now_ns = START
    bus.receive(now_ns)
    other.receive(now_ns)
    frames: list[CanFrame] = []
    for gap in gaps:
        now_ns += gap
        frames += bus.receive(now_ns)[0]
    assert frames == other.receive(now_ns)[0]
    assert stamps(frames) == sorted(stamps(frames))
    assert all(START < stamp <= now_ns for stamp in stamps(frames))


def test_two_runs_are_equal() -> None:
    command = CanFrame("can0", 0x200, pack(">4h", 500, -200, 300, 100))
    first, second = SimulatedBus(OMNI), SimulatedBus(OMNI)
    assert drive(first, 50, [command]) == drive(second, 50, [command])
    assert first.robot.truth == second.robot.truth


def test_command_acts_only_after_its_last_bit() -> None:
    bus = SimulatedBus(OMNI)
    bus.receive(START)
    bus.send([CanFrame("can0", 0x200, pack(">4h", 8000, 8000, 8000, 8000))], START + 900_000)
    bus.receive(START + 2 * MILLISECOND)
    assert bus.robot.truth.twist == (0.0, 0.0, 0.0)
    bus.receive(START + 3 * MILLISECOND)
    assert bus.robot.truth.twist.wz != 0.0


# -- load -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("stuffing", "expected"), [(Stuffing.WORST, 0.675), (Stuffing.TYPICAL, 0.575)])
def test_load_of_four_esc_at_1_khz(stuffing: Stuffing, expected: float) -> None:
    bus = SimulatedBus(OMNI, stuffing=stuffing)
    drive(bus, 1000, [ZERO], period_ns=MILLISECOND)
    assert bus.load("can0") == pytest.approx(expected, abs=0.002)


def test_load_of_three_odrives_at_250_hz() -> None:
    bus = SimulatedBus(MOBY)
    setpoints = [CanFrame("can0", node << 5 | 0x0D, bytes(8)) for node in (1, 2, 3)]
    drive(bus, 250, setpoints)
    slow = 3 * (10 + 10 + 2 + 2) * 135e-6
    assert bus.load("can0") == pytest.approx(3 * 2 * 250 * 135e-6 + slow, rel=0.02)


# -- faults -----------------------------------------------------------------------------------------------------------


def test_drop_fraction_and_seed() -> None:
    runs = []
    for seed in (1, 1, 2):
        bus = SimulatedBus(OMNI)
        bus.drop("can0", received=0.25, seed=seed)
        runs.append(drive(bus, 250)[0])
    assert runs[0] == runs[1] != runs[2]
    assert len(runs[0]) == pytest.approx(0.75 * 4000, rel=0.05)


def test_dropped_commands_do_not_move_the_robot() -> None:
    bus = SimulatedBus(OMNI)
    bus.drop("can0", sent=1.0)
    received, events = drive(bus, 20, [CanFrame("can0", 0x200, pack(">4h", 8000, 8000, 8000, 8000))])
    assert bus.robot.truth.pose == (0.0, 0.0, 0.0)
    assert (len(received) > 250, events) == (True, [])


def test_interface_down_and_up() -> None:
    bus = SimulatedBus(OMNI)
    drive(bus, 5, [ZERO])
    bus.fail("can0")
    received, events = drive(bus, 5, [ZERO], start_ns=START + 20 * MILLISECOND)
    assert received == []
    assert [(event.kind, event.occurrences) for event in events] == [(BusEventKind.DOWN, 1)] + 4 * [
        (BusEventKind.TX_DROPPED, 1)
    ]
    bus.restore("can0")
    received, events = drive(bus, 5, [ZERO], start_ns=START + 40 * MILLISECOND)
    assert {event.kind for event in events} == {BusEventKind.TX_DROPPED, BusEventKind.UP}
    assert min(stamps(received)) >= START + 36 * MILLISECOND
    assert len(received) > 60


def test_lone_host_goes_passive_and_its_queue_fills() -> None:
    bus = SimulatedBus(OMNI)
    drive(bus, 2)
    for name in bus.robot.devices:
        dji(bus, name).unplug()
    _, events = drive(bus, HOST_QUEUE + 11, [ZERO], start_ns=START + 8 * MILLISECOND)
    assert [event.kind for event in events] == [BusEventKind.ERROR_PASSIVE] + 10 * [BusEventKind.TX_DROPPED]
    dji(bus, "rear_left").plug()
    _, events = drive(bus, 3, start_ns=START + 300 * MILLISECOND)
    assert BusEventKind.ERROR_ACTIVE in {event.kind for event in events}


def test_babbling_node_starves_the_bus_and_leaves() -> None:
    bus = SimulatedBus(OMNI)
    drive(bus, 2)
    bus.babble("can0", CanFrame("can0", 0x000, bytes(8)), rate_hz=20_000.0)
    received, events = drive(bus, 10, [ZERO], start_ns=START + 8 * MILLISECOND)
    assert {frame.id for frame in received[4:]} == {0}
    assert events == []
    bus.babble("can0", CanFrame("can0", 0x000, bytes(8)), rate_hz=0.0)
    received, _ = drive(bus, 10, start_ns=START + 48 * MILLISECOND)
    assert sum(frame.id != 0 for frame in received) == pytest.approx(4 * 36, abs=20)


def test_second_master_is_heard_by_the_motors() -> None:
    bus = SimulatedBus(OMNI)
    drive(bus, 2)
    bus.babble("can0", CanFrame("can0", 0x200, pack(">4h", 900, 900, 900, 900)), rate_hz=100.0)
    drive(bus, 50, start_ns=START + 8 * MILLISECOND)
    assert abs(bus.robot.truth.twist.wz) > 0.1


def test_unplugged_motor_falls_silent_the_others_talk_on() -> None:
    bus = SimulatedBus(OMNI)
    drive(bus, 2)
    dji(bus, "rear_left").unplug()
    received, _ = drive(bus, 10, start_ns=START + 12 * MILLISECOND)
    assert {frame.id for frame in received[8:]} == {0x201, 0x203, 0x204}
