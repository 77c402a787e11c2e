"""DJI: turns counted across gaps, shared command frames, silence."""

from math import pi
from struct import pack

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.dji import DjiDriver
from drivers.interface import COAST, CanFrame, CommandKind, MotorCommand, MotorState
from tests.drivers.rig import BUS, MS, can_text, spec

TICK = 2.0 * pi / 8192


def fed(driver: DjiDriver, *, id: int = 1, angle: int, rpm: int = 0, at: int) -> bool:
    data = pack(">HhhBB", angle, rpm, 0, 25, 0)
    return driver.receive(CanFrame(BUS, 0x200 + id, data, received_ns=at))


def position_ticks(driver: DjiDriver) -> int:
    position = driver.feedback(now_ns=0)[0].position
    assert position is not None
    return round(position / TICK)


@pytest.mark.parametrize("step", [1, 700, 4095, -1, -700, -4095])
def test_turns_add_up_without_gaps(step: int) -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    rpm = round(step / 8192 * 60_000)  # one frame per ms
    for index in range(3000):
        assert fed(driver, angle=(100 + index * step) % 8192, rpm=max(-32768, min(32767, rpm)), at=index * MS)
    assert position_ticks(driver) == 100 + 2999 * step


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 200), st.integers(-9000, 9000)), min_size=1, max_size=20),
    st.integers(0, 8191),
)
def test_turns_across_gaps_follow_the_speed(gaps: list[tuple[int, int]], start: int) -> None:
    """Speed changes evenly in each gap, so its ends tell the mean; the rpm field is rounded as the controller does."""
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    rpm, total, now = 0, float(start), 0
    fed(driver, angle=start, rpm=rpm, at=now)
    for milliseconds, faster in gaps:
        total += 0.5 * (rpm + faster) / 60_000 * milliseconds * 8192
        rpm, now = faster, now + milliseconds * MS
        fed(driver, angle=round(total) % 8192, rpm=rpm, at=now)
    assert position_ticks(driver) == round(total)


def test_a_second_at_9000_rpm_unheard_is_150_turns() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    fed(driver, angle=0, rpm=9000, at=0)
    fed(driver, angle=40, rpm=9000, at=1000 * MS)
    assert position_ticks(driver) == 150 * 8192 + 40


def test_a_stamp_that_goes_back_counts_as_no_gap() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    fed(driver, angle=0, rpm=9000, at=1000 * MS)
    fed(driver, angle=8000, rpm=9000, at=0)
    assert position_ticks(driver) == -192


def test_an_angle_no_encoder_has_is_not_taken() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    assert not fed(driver, angle=8192, at=0)
    assert driver.feedback(now_ns=0)[0].state is MotorState.SILENT


def test_one_frame_per_four_ids_and_unused_slots_are_zero() -> None:
    driver = DjiDriver(BUS, [spec("c610", id=6), spec("c620", id=1), spec("c620", id=4)])
    for id in (1, 4, 6):
        fed(driver, id=id, angle=0, at=0)
    constant = 0.3 * 187 / 3591
    commands = [MotorCommand(CommandKind.TORQUE, torque) for torque in (0.005, 10 * constant, -20 * constant)]
    assert [can_text(frame) for frame in driver.command(commands, now_ns=1)] == [
        "200#200000000000C000",
        "1FF#000003E800000000",
    ]
    assert [frame.id for frame in DjiDriver(BUS, [spec("c620", id=5)]).coast_frames()] == [0x1FF]
    assert [frame.id for frame in DjiDriver(BUS, [spec("c620", id=4)]).stop_frames()] == [0x200]


@pytest.mark.parametrize(("torque", "current", "raw"), [(0.1, 20.0, 5243), (9.0, 3.0, 2457), (9.0, 99.0, 16384)])
def test_the_tightest_limit_holds(torque: float, current: float, raw: int) -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(max_torque=torque, max_current=current)])
    fed(driver, angle=0, at=0)
    (frame,) = driver.command([MotorCommand(CommandKind.TORQUE, 50.0)], now_ns=1)
    assert frame.data == pack(">4h", raw, 0, 0, 0)


def test_silent_after_50_ms_and_current_zero() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(feedback_rate=1000.0)])
    fed(driver, angle=0, at=0)
    pull = [MotorCommand(CommandKind.TORQUE, 0.1)]
    assert any(driver.command(pull, now_ns=50 * MS - 1)[0].data)
    assert driver.feedback(now_ns=50 * MS - 1)[0].state is MotorState.OPERATIONAL
    assert driver.feedback(now_ns=50 * MS)[0].state is MotorState.SILENT
    assert not any(driver.command(pull, now_ns=50 * MS)[0].data)
    assert not any(driver.command([COAST], now_ns=1)[0].data)
    assert driver.feedback(now_ns=1)[0].state is MotorState.IDLE
