"""The simulated C620, C610 and GM6020 against the manuals' tables: bytes, scales, wrap, faults."""

from math import pi
from struct import pack, unpack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.contract import CanFrame
from replay.sim.controllers.contract import STEP_NS, MotorSetup, Shaft
from replay.sim.controllers.dji import SimulatedDji

SETUP = MotorSetup(
    name="motor",
    bus="can0",
    id=1,
    variant="c620",
    max_speed=900.0,
    max_torque=0.3125,
    max_current=20.0,
    inertia=1e-4,
    feedback_rate=1000.0,
    watchdog_s=None,
)
C620_TORQUE_CONSTANT = 0.3 * 187 / 3591
RPM = 2.0 * pi / 60.0


def device(motor_id: int = 1, variant: str = "c620", *, rate: float = 1000.0) -> SimulatedDji:
    simulated = SimulatedDji(SETUP._replace(id=motor_id, variant=variant, feedback_rate=rate))
    simulated.start(Shaft(0.0, 0.0), 0)
    return simulated


def command(simulated: SimulatedDji, identifier: int, *raw: int) -> float:
    """Torque after a command frame, at standstill."""
    simulated.receive(CanFrame("can0", identifier, pack(">4h", *raw)), 0)
    return simulated.step(Shaft(0.0, 0.0), STEP_NS)


def feedback(simulated: SimulatedDji, now_ns: int = 10 * STEP_NS) -> CanFrame:
    return simulated.poll(now_ns)[-1].frame


@pytest.mark.parametrize(("motor_id", "current"), [(1, 2.0), (2, -2.0), (3, 0.0)])
def test_golden_command_of_the_first_four(motor_id: int, current: float) -> None:
    simulated = device(motor_id)
    simulated.receive(CanFrame("can0", 0x200, bytes.fromhex("0666F99A00004000")), 0)
    torque = simulated.step(Shaft(0.0, 0.0), STEP_NS)
    assert torque / C620_TORQUE_CONSTANT == pytest.approx(current, abs=20 / 16384)


def test_golden_command_full_scale_saturates_at_the_motor_limit() -> None:
    simulated = device(4)
    simulated.receive(CanFrame("can0", 0x200, bytes.fromhex("0666F99A00004000")), 0)
    assert simulated.step(Shaft(0.0, 0.0), STEP_NS) == pytest.approx(min(20 * C620_TORQUE_CONSTANT, 0.3125))


def test_golden_command_of_c610_in_the_second_group() -> None:
    simulated = device(6, "c610")
    simulated.receive(CanFrame("can0", 0x1FF, bytes.fromhex("000005DC00000000")), 0)
    assert simulated.step(Shaft(0.0, 0.0), STEP_NS) == pytest.approx(1.5 * 0.18 / 36)


def test_golden_feedback() -> None:
    simulated = device()
    simulated.temperature_c = 41.0
    simulated.receive(CanFrame("can0", 0x200, pack(">4h", -1638, 0, 0, 0)), 0)
    simulated.step(Shaft(pi, -3600 * RPM * 1.0000001), STEP_NS)
    frame = feedback(simulated)
    assert (frame.id, frame.data.hex().upper(), frame.extended) == (0x201, "1000F1F0F99A2900", False)


def test_c610_reports_no_temperature() -> None:
    simulated = device(variant="c610")
    simulated.temperature_c = 70.0
    assert feedback(simulated).data[6] == 0


@pytest.mark.parametrize(("variant", "full_scale"), [("c620", 16384), ("c610", 10000)])
@pytest.mark.parametrize("sign", [1, -1])
def test_command_beyond_full_scale_saturates(variant: str, full_scale: int, sign: int) -> None:
    beyond, at = device(variant=variant), device(variant=variant)
    assert command(beyond, 0x200, sign * 32767, 0, 0, 0) == command(at, 0x200, sign * full_scale, 0, 0, 0)


def test_other_slots_and_frames_are_ignored() -> None:
    simulated = device(2)
    assert command(simulated, 0x200, 5000, 0, 5000, 5000) == 0.0
    assert command(simulated, 0x1FF, 5000, 5000, 5000, 5000) == 0.0
    data = pack(">4h", 0, 5000, 0, 0)
    for frame in (
        CanFrame("can0", 0x200, data, extended=True),
        CanFrame("can0", 0x200, data, remote=True),
        CanFrame("can0", 0x200, data[:4]),
    ):
        simulated.receive(frame, 0)
        assert simulated.step(Shaft(0.0, 0.0), STEP_NS) == 0.0


def test_last_command_is_held_for_ever() -> None:
    simulated = device()
    torque = command(simulated, 0x200, 1000, 0, 0, 0)
    assert simulated.step(Shaft(0.0, 0.0), 3600 * 1000 * STEP_NS) == torque


def test_back_emf_ends_a_runaway() -> None:
    simulated = device()
    command(simulated, 0x200, 10000, 0, 0, 0)
    no_load = 482 * RPM * 3591 / 187
    assert simulated.step(Shaft(0.0, no_load), STEP_NS) == 0.0
    assert simulated.step(Shaft(0.0, -no_load), STEP_NS) > 0.0


@given(turns=st.floats(-1e4, 1e4))
def test_angle_wraps_at_8192(turns: float) -> None:
    simulated = device()
    simulated.step(Shaft(turns * 2.0 * pi, 0.0), STEP_NS)
    ticks = unpack(">H", feedback(simulated).data[:2])[0]
    assert 0 <= ticks < 8192
    difference = (ticks / 8192 - turns) % 1.0
    assert difference < 1e-6 or difference > 1.0 - 1.01 / 8192


def test_speed_truncates_toward_zero_and_saturates() -> None:
    simulated = device()
    for rpm, expected in ((1.9, 1), (-1.9, -1), (1e6, 32767), (-1e6, -32767)):
        simulated.step(Shaft(0.0, rpm * RPM), STEP_NS)
        assert simulated.poll(simulated._clock.due_ns)[0].frame.data[2:4] == pack(">h", expected)


@pytest.mark.parametrize("rate", [1000.0, 500.0])
def test_feedback_rate_and_own_phase(rate: float) -> None:
    ready = [emission.ready_ns for emission in device(1, rate=rate).poll(1_000_000_000)]
    assert len(ready) == pytest.approx(rate, abs=1)
    assert ready == sorted(ready)
    other = [emission.ready_ns for emission in device(2, rate=rate).poll(1_000_000_000)]
    assert other[0] != ready[0]
    assert other[1] - other[0] != ready[1] - ready[0]
    assert ready[1] - ready[0] == pytest.approx(1e9 / rate, rel=101e-6)


def test_unplugged_motor_keeps_pulling_unheard() -> None:
    simulated = device()
    torque = command(simulated, 0x200, 1000, 0, 0, 0)
    simulated.unplug()
    assert command(simulated, 0x200, 0, 0, 0, 0) == torque
    assert simulated.poll(20 * STEP_NS) == []
    simulated.plug()
    assert command(simulated, 0x200, 0, 0, 0, 0) == 0.0
    assert simulated.poll(40 * STEP_NS) != []


def test_power_cycle_forgets_the_command_and_keeps_the_angle_within_a_turn() -> None:
    simulated = device()
    command(simulated, 0x200, 1000, 0, 0, 0)
    simulated.power_off()
    assert simulated.step(Shaft(5.5 * 2.0 * pi, 0.0), STEP_NS) == 0.0
    assert not simulated.acknowledges
    simulated.power_on()
    assert simulated.step(Shaft(5.5 * 2.0 * pi, 0.0), STEP_NS) == 0.0
    assert unpack(">H", feedback(simulated).data[:2])[0] == 4096


def test_frozen_encoder_repeats_the_angle_at_zero_speed() -> None:
    simulated = device()
    simulated.step(Shaft(pi, 100.0), STEP_NS)
    simulated.encoder_frozen = True
    simulated.step(Shaft(2.0, 100.0), STEP_NS)
    assert unpack(">Hh", feedback(simulated).data[:4]) == (4096, 0)


@pytest.mark.parametrize(("motor_id", "variant"), [(0, "c620"), (9, "c620"), (1, "c630"), (8, "gm6020"), (1, "gm6020")])
def test_wrong_setup_names_the_motor(motor_id: int, variant: str) -> None:
    with pytest.raises(ValueError, match="motor motor"):
        SimulatedDji(SETUP._replace(id=motor_id, variant=variant))


# -- GM6020: 0.741 N m/A, 13.33 rpm/V, 156 rpm per N m, so 8.672 ohm as its torque-speed line has it ------------------


def gm6020(mode: str, motor_id: int = 2, supply: float = 24.0) -> SimulatedDji:
    simulated = SimulatedDji(
        SETUP._replace(id=motor_id, variant="gm6020", options={"mode": mode}, supply=supply, max_torque=1.2)
    )
    simulated.start(Shaft(0.0, 0.0), 0)
    return simulated


def told(simulated: SimulatedDji, identifier: int, raw: int, *, rpm: float) -> float:
    """Torque of a command in the second slot at this speed."""
    simulated.receive(CanFrame("can0", identifier, pack(">4h", 0, raw, 0, 0)), 0)
    return simulated.step(Shaft(0.0, rpm * RPM), STEP_NS)


def test_golden_voltage_is_half_of_the_supply() -> None:
    simulated = gm6020("voltage")
    simulated.receive(CanFrame("can0", 0x1FF, bytes.fromhex("000030D400000000")), 0)
    assert simulated.step(Shaft(0.0, 0.0), STEP_NS) == pytest.approx(0.741 * 12.0 / 8.672, rel=1e-3)
    assert simulated.step(Shaft(0.0, 12.0 * 13.33 * RPM), STEP_NS) == pytest.approx(0.0, abs=1e-9)
    assert gm6020("voltage", supply=20.0)._supply == 20.0


def test_the_line_of_the_data_sheet() -> None:
    """All of the supply: 320 rpm without a load, 156 rpm less for each N m, so 1.2 N m at 132 rpm."""
    simulated = gm6020("voltage")
    assert told(simulated, 0x1FF, 25000, rpm=132.8) == pytest.approx(1.2, abs=0.002)
    assert told(simulated, 0x1FF, 25000, rpm=164.0) == pytest.approx(1.0, abs=0.002)
    assert told(simulated, 0x1FF, 32767, rpm=164.0) == pytest.approx(1.0, abs=0.002)
    assert told(simulated, 0x1FF, -25000, rpm=-164.0) == pytest.approx(-1.0, abs=0.002)


def test_no_voltage_brakes_and_never_drives() -> None:
    simulated = gm6020("voltage")
    for rpm in (-300.0, -10.0, 10.0, 300.0):
        assert told(simulated, 0x1FF, 0, rpm=rpm) == pytest.approx(-rpm / 156.0, rel=1e-3)


def test_the_current_stays_within_the_scale_of_the_controller() -> None:
    simulated = gm6020("voltage")
    assert told(simulated, 0x1FF, 25000, rpm=-320.0) == 3.0 * 0.741
    assert unpack(">h", feedback(simulated).data[4:6])[0] == 16384


def test_a_current_is_given_as_far_as_the_supply_goes() -> None:
    simulated = gm6020("current")
    assert told(simulated, 0x1FE, 8192, rpm=0.0) == pytest.approx(1.5 * 0.741)
    assert told(simulated, 0x1FE, 8192, rpm=240.0) == pytest.approx(80.0 / 156.0, rel=1e-2)
    assert told(simulated, 0x1FE, 32767, rpm=-200.0) == 3.0 * 0.741
    assert told(simulated, 0x1FE, 0, rpm=300.0) == 0.0, "it rolls on"


@pytest.mark.parametrize(
    ("mode", "motor_id", "own"),
    [("voltage", 2, 0x1FF), ("voltage", 6, 0x2FF), ("current", 2, 0x1FE), ("current", 6, 0x2FE)],
)
def test_it_hears_the_frame_of_its_mode_and_answers_by_its_id(mode: str, motor_id: int, own: int) -> None:
    simulated = gm6020(mode, motor_id)
    for identifier in (0x200, 0x1FF, 0x2FF, 0x1FE, 0x2FE):
        simulated = gm6020(mode, motor_id)
        assert (told(simulated, identifier, 5000, rpm=0.0) > 0.0) == (identifier == own)
    frame = feedback(simulated)
    assert (frame.id, len(frame.data), frame.data[7]) == (0x204 + motor_id, 8, 0)


def test_a_volt_is_held_for_ever_too() -> None:
    simulated = gm6020("voltage")
    torque = told(simulated, 0x1FF, 5000, rpm=0.0)
    simulated.unplug()
    assert told(simulated, 0x1FF, 0, rpm=0.0) == torque
    simulated.power_off()
    assert simulated.step(Shaft(0.0, 10.0), STEP_NS) == 0.0, "without a supply nothing shorts the windings"
