"""The simulated ODrive: parameters, command watchdog and faults."""

from math import pi
from struct import pack, unpack

import pytest

from replay.sim.controllers.contract import Shaft
from replay.sim.controllers.odrive_tables import AxisState
from tests.replay.test_sim_odrive import ENABLE, TIMEOUT, WATCHDOG_S, Bench

# -- parameters and watchdog ------------------------------------------------------------------------------------------


def test_sdo_write_then_read() -> None:
    bench = Bench(watchdog_s=WATCHDOG_S)
    assert bench.send(0x04, pack("<BHBf", 1, TIMEOUT, 0, 0.25)) == []
    reply = bench.send(0x04, pack("<BHB", 0, TIMEOUT, 0))[0]
    assert reply.id == 3 << 5 | 0x05
    assert unpack("<BHBf", reply.data) == (0, TIMEOUT, 0, 0.25)
    assert bench.send(0x04, pack("<BHB", 0, ENABLE, 0))[0].data[4] == 0
    assert bench.send(0x04, pack("<BHB", 0, 4711, 0)) == []


def test_watchdog_of_06_counts_from_arming_and_is_fed_by_setpoints() -> None:
    bench = Bench(watchdog_s=WATCHDOG_S)
    bench.enable_watchdog()
    bench.run(200)
    assert bench.device.axis.errors == 0
    bench.arm()
    for _ in range(20):
        bench.run(40)
        bench.send(0x0D, pack("<ff", 0.0, 0.0))
    assert bench.state() is AxisState.CLOSED_LOOP
    bench.run(30)
    bench.send(0x09, remote=True)
    bench.run(21)  # 0.05 s as float32 is a little more
    assert (bench.state(), bench.device.axis.errors) == (AxisState.IDLE, 0x01000000)


def test_watchdog_of_05_is_fed_by_any_frame_and_expires_in_idle() -> None:
    bench = Bench("0.5", watchdog_s=WATCHDOG_S)
    for _ in range(10):
        bench.run(49)
        bench.send(0x1A)
    assert bench.device.axis.errors == 0
    bench.run(50)
    assert bench.device.axis.errors == 0x800
    bench.arm()
    assert bench.state() is AxisState.CLOSED_LOOP


@pytest.mark.parametrize("variant", ["0.5", "0.6"])
def test_watchdog_expiry_is_timely_coasts_and_latches(variant: str) -> None:
    bench = Bench(variant, watchdog_s=WATCHDOG_S)
    bench.enable_watchdog()
    bench.arm()
    bench.send(0x0D, pack("<ff", 3.0, 0.0))
    bench.run(49)
    assert bench.state() is AxisState.CLOSED_LOOP
    bench.run(2)
    assert (bench.state(), bench.torque) == (AxisState.IDLE, 0.0)
    bench.send(0x0D, pack("<ff", 3.0, 0.0))
    bench.send(0x07, pack("<I", 8))
    bench.run(1)
    assert bench.state() is AxisState.IDLE
    bench.send(0x18)
    bench.send(0x07, pack("<I", 8))
    bench.run(1)
    assert bench.state() is AxisState.CLOSED_LOOP


# -- faults -----------------------------------------------------------------------------------------------------------


def test_unplugged_node_is_silent_and_deaf_and_its_watchdog_bites() -> None:
    bench = Bench(watchdog_s=WATCHDOG_S)
    bench.enable_watchdog()
    bench.arm()
    bench.device.unplug()
    heard = len(bench.frames)
    bench.run(100)
    assert bench.send(0x09, remote=True) == []
    assert len(bench.frames) == heard
    bench.device.plug()
    bench.run(100)
    assert bench.last(0x01) == "0000000101030000"


def test_power_cycle_forgets_position_mode_and_unsaved_parameters() -> None:
    bench = Bench(watchdog_s=WATCHDOG_S)
    bench.shaft = Shaft(12.0 * 2.0 * pi, 0.0)
    bench.enable_watchdog()
    bench.arm()
    bench.run(10)
    assert unpack("<ff", bench.send(0x09, remote=True)[0].data)[0] == pytest.approx(12.0)
    bench.device.power_cycle()
    assert bench.state() is AxisState.IDLE
    assert unpack("<ff", bench.send(0x09, remote=True)[0].data)[0] == 0.0
    assert bench.send(0x04, pack("<BHB", 0, ENABLE, 0))[0].data[4] == 0
    assert bench.device.axis.control.control_mode == 3


def test_saved_parameters_survive_a_power_cycle_until_erased() -> None:
    bench = Bench(watchdog_s=WATCHDOG_S)
    bench.enable_watchdog()
    bench.send(0x16, b"\x01")
    bench.device.power_cycle()
    assert bench.send(0x04, pack("<BHB", 0, ENABLE, 0))[0].data[4] == 1
    bench.send(0x16, b"\x02")
    assert bench.send(0x04, pack("<BHB", 0, ENABLE, 0)) == []
    bench.run(500)
    assert bench.send(0x04, pack("<BHB", 0, ENABLE, 0))[0].data[4] == 0


def test_absolute_position_re_references_the_reading() -> None:
    bench = Bench(turns=100.0)
    bench.send(0x19, pack("<f", 2.5))
    assert unpack("<ff", bench.send(0x09, remote=True)[0].data)[0] == 2.5


def test_phase_loss_drops_the_state_without_an_error() -> None:
    bench = Bench()
    bench.arm()
    bench.device.axis.phase_connected = False
    bench.run(1)
    assert (bench.state(), bench.torque, bench.device.axis.errors) == (AxisState.IDLE, 0.0, 0)
    bench.arm()
    assert bench.state() is AxisState.IDLE


def test_frozen_encoder_winds_up_to_full_torque() -> None:
    bench = Bench()
    bench.arm()
    bench.device.axis.encoder_frozen = True
    bench.send(0x0D, pack("<ff", 25.0, 0.0))
    bench.run(200)
    assert bench.torque == 1.5
    assert unpack("<ff", bench.send(0x09, remote=True)[0].data) == (0.0, 0.0)


def test_powered_off_node_is_dead() -> None:
    bench = Bench()
    bench.arm()
    bench.send(0x0D, pack("<ff", 5.0, 0.0))
    bench.run(3)
    bench.device.power_off()
    bench.frames.clear()
    bench.run(200)
    assert (bench.frames, bench.torque) == ([], 0.0)
