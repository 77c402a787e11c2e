"""The simulated ODrive: arming, control modes, limits."""

from math import inf, nan, pi
from struct import pack

import pytest

from replay.sim.controllers.odrive_tables import AxisState
from tests.replay.test_sim_odrive import Bench


@pytest.mark.parametrize("variant", ["0.5", "0.6"])
@pytest.mark.parametrize("mode", [1, 2])
def test_armed_velocity_mode_reaches_the_setpoint(variant: str, mode: int) -> None:
    bench = Bench(variant)
    bench.arm(mode=mode)
    bench.send(0x0D, pack("<ff", 12.5, 0.0))
    bench.run(1000)
    assert bench.speed == pytest.approx(12.5, rel=1e-3)


def test_idle_axis_gives_no_torque() -> None:
    bench = Bench()
    bench.send(0x0B, pack("<II", 2, 1))
    bench.send(0x0D, pack("<ff", 5.0, 0.5))
    bench.run(50)
    assert bench.speed == 0.0


def test_short_state_request_is_accepted_and_shorter_ones_are_not() -> None:
    bench = Bench()
    bench.send(0x07, b"\x08\x00\x00")
    bench.run(1)
    assert bench.state() is AxisState.IDLE
    bench.send(0x07, b"\x08\x00\x00\x00")
    bench.run(1)
    assert bench.state() is AxisState.CLOSED_LOOP


def test_arming_is_refused_until_errors_are_cleared() -> None:
    bench = Bench()
    bench.device.raise_error(0x4000)
    bench.send(0x07, pack("<I", 8))
    bench.run(2)
    assert bench.state() is AxisState.IDLE
    bench.send(0x18)
    bench.send(0x07, pack("<I", 8))
    bench.run(2)
    assert bench.state() is AxisState.CLOSED_LOOP


def test_persistent_condition_returns_after_clear() -> None:
    bench = Bench()
    bench.device.axis.condition = 0x200
    bench.arm()
    assert (bench.state(), bench.device.axis.errors) == (AxisState.IDLE, 0x200)


def test_stale_setpoint_acts_on_the_next_arming() -> None:
    bench = Bench()
    bench.arm()
    bench.send(0x0D, pack("<ff", 5.0, 0.0))
    bench.run(200)
    bench.send(0x07, pack("<I", 1))
    bench.run(1)
    assert (bench.state(), bench.torque) == (AxisState.IDLE, 0.0)
    bench.shaft = bench.shaft._replace(velocity=0.0)
    bench.send(0x07, pack("<I", 8))
    bench.run(300)
    assert bench.speed == pytest.approx(5.0, rel=0.05)


def test_torque_mode_and_current_limit() -> None:
    bench = Bench()
    bench.arm(control=1)
    bench.send(0x0E, pack("<f", -0.01))
    bench.run(1)
    assert bench.torque == pytest.approx(-0.01)
    bench.send(0x0F, pack("<ff", 30.0, 4.0))
    bench.send(0x0E, pack("<f", 1.0))
    bench.run(1)
    assert bench.torque == pytest.approx(4.0 * 1.5 / 40.0)


def test_torque_never_exceeds_the_motor_limit() -> None:
    bench = Bench()
    bench.arm()
    bench.send(0x0F, pack("<ff", inf, 1e9))
    bench.send(0x0D, pack("<ff", 1e9, 0.0))
    bench.run(5)
    assert bench.torque == 1.5


def test_position_mode_is_the_default_and_holds() -> None:
    bench = Bench(turns=4.0)
    bench.send(0x07, pack("<I", 8))
    bench.run(300)
    assert bench.shaft.position / (2.0 * pi) == pytest.approx(4.0)


def test_overspeed_disarms() -> None:
    bench = Bench()
    bench.arm()
    bench.shaft = bench.shaft._replace(velocity=37.0 * 2.0 * pi)
    bench.run(1)
    assert (bench.state(), bench.device.axis.errors) == (AxisState.IDLE, 0x8000)


@pytest.mark.parametrize(("variant", "error"), [("0.6", 0x40), ("0.5", 0x200)])
def test_setpoint_that_is_not_a_number_disarms(variant: str, error: int) -> None:
    bench = Bench(variant)
    bench.arm()
    bench.send(0x0D, pack("<ff", nan, 0.0))
    bench.run(1)
    assert (bench.state(), bench.torque, bench.device.axis.errors) == (AxisState.IDLE, 0.0, error)


def test_unknown_state_is_refused() -> None:
    bench = Bench("0.5")
    bench.send(0x07, pack("<I", 99))
    bench.run(1)
    assert bench.device.axis.errors == 0x1
    bench.arm()
    assert bench.state() is AxisState.CLOSED_LOOP


def test_estop_is_a_coast_and_latches() -> None:
    bench = Bench()
    bench.arm()
    bench.send(0x0D, pack("<ff", 5.0, 0.0))
    bench.run(300)
    bench.send(0x02)
    bench.run(100)
    assert bench.speed == pytest.approx(5.0, rel=0.05)
    assert (bench.state(), bench.device.axis.errors) == (AxisState.IDLE, 0x02000000)
