"""The electrical model of a motor, against closed forms and the data sheet of the papers' stand-in motor."""

from math import exp, pi

import pytest

from replay.sim.controllers.dc_motor import DcMotor, Winding

RPM = 2.0 * pi / 60.0
FAULHABER = DcMotor(resistance=2.83, constant=5.35e-3, inductance=70e-6)  # 1331T006SR: 6 V
ROTOR = 0.71e-7  # kg m^2: 0.71 g cm^2
SLOW = DcMotor(resistance=0.5, constant=0.08, inductance=1.5e-3)  # L/R = 3 ms


def test_the_data_sheet_of_a_motor_is_what_its_constants_say() -> None:
    """Stall 11.2 mN m, 10600 rpm, 7 ms, 0.56 mV/rpm: none of them was told."""
    assert FAULHABER.torque(FAULHABER.current(6.0, 0.0)) == pytest.approx(11.2e-3, rel=0.02)
    assert 6.0 / FAULHABER.back_emf(RPM) == pytest.approx(10600, rel=0.02)
    assert FAULHABER.back_emf(RPM) == pytest.approx(0.56e-3, rel=0.002)
    assert FAULHABER.time_constant(ROTOR) == pytest.approx(7e-3, rel=0.01)


def test_a_voltage_and_its_current_are_each_others_inverse() -> None:
    for current, rate in ((0.0, 0.0), (1.5, 300.0), (-2.0, 300.0), (0.7, -900.0)):
        assert FAULHABER.current(FAULHABER.voltage(current, rate), rate) == pytest.approx(current, abs=1e-12)


def test_power_in_is_heat_and_work() -> None:
    voltage, rate = 5.0, 400.0
    current = FAULHABER.current(voltage, rate)
    assert voltage * current == pytest.approx(2.83 * current**2 + FAULHABER.torque(current) * rate)


def test_a_current_rises_as_the_exponential_says() -> None:
    """i = V/R (1 - e^(-t R/L)) at rest, and the torques of the substeps add up to the integral of it."""
    winding = Winding(SLOW)
    impulse = 0.0
    for step in range(1, 21):
        impulse += 1e-3 * winding.step(2.0, 0.0)
        t = 1e-3 * step
        assert winding.current == pytest.approx(4.0 * (1.0 - exp(-t / 3e-3)), rel=1e-12)
        assert impulse == pytest.approx(0.08 * 4.0 * (t - 3e-3 * (1.0 - exp(-t / 3e-3))), rel=1e-12)


def test_back_emf_takes_its_part_of_the_voltage() -> None:
    winding = Winding(SLOW)
    for _ in range(100):
        winding.step(2.0, 10.0)
    assert winding.current == pytest.approx((2.0 - 0.8) / 0.5)
    assert winding.step(0.8, 10.0) == pytest.approx(0.08 * 2.4 * 3.0 * (1.0 - exp(-1.0 / 3.0)))


@pytest.mark.parametrize(("lag", "ignored"), [(0.1999e-3, True), (0.2e-3, False)])
def test_an_inductance_below_a_fifth_of_the_substep_is_left_out(lag: float, ignored: bool) -> None:
    winding = Winding(DcMotor(resistance=2.0, constant=0.01, inductance=2.0 * lag))
    torque = winding.step(6.0, 0.0)
    assert (winding.current == 3.0) is ignored
    assert torque == pytest.approx(0.03 if ignored else 0.03 * (1.0 - 0.2 * (1.0 - exp(-5.0))))


def test_of_the_stand_in_motor_it_is_left_out() -> None:
    """70 uH / 2.83 ohm = 25 us."""
    winding = Winding(FAULHABER)
    assert winding.step(6.0, 0.0) == pytest.approx(5.35e-3 * 6.0 / 2.83, rel=1e-15)


def test_a_finer_substep_feels_the_inductance() -> None:
    winding = Winding(FAULHABER, 25e-6)
    winding.step(6.0, 0.0)
    assert winding.current == pytest.approx(6.0 / 2.83 * (1.0 - exp(-25e-6 * 2.83 / 70e-6)))


def test_a_current_that_is_held_is_there_at_once_and_open_terminals_carry_none() -> None:
    winding = Winding(SLOW)
    assert winding.hold(2.5) == pytest.approx(0.2)
    assert winding.step(SLOW.voltage(2.5, 30.0), 30.0) == pytest.approx(0.2), "the current goes on from there"
    assert winding.hold(0.0) == 0.0
    assert winding.current == 0.0


@pytest.mark.parametrize("motor", [DcMotor(0.0, 1.0), DcMotor(1.0, 0.0), DcMotor(1.0, 1.0, -1e-6)])
def test_what_is_no_motor_is_refused(motor: DcMotor) -> None:
    with pytest.raises(ValueError, match="resistance and constant must be above zero"):
        Winding(motor)
