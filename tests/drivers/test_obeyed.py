"""What the capabilities of a driver claim, its simulated controller does; nothing else is taken."""

from collections.abc import Callable

import pytest

from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from tests.drivers.rig import UNDER_CONTRACT, claimed
from tests.drivers.shop import FRICTION, GOING, ON_THE_GROUND, Shop, kind_of

every_variant = pytest.mark.parametrize(("driver", "variant"), UNDER_CONTRACT)
VELOCITY, TORQUE, VOLTAGE = CommandKind.VELOCITY, CommandKind.TORQUE, CommandKind.VOLTAGE


def reaches_its_velocity(shop: Shop) -> None:
    for speed in (200.0, -90.0):
        shop.drive(MotorCommand(VELOCITY, speed), ms=2_000)
        assert shop.shaft.velocity == pytest.approx(speed, rel=1e-3)


def gives_its_torque(shop: Shop) -> None:
    for torque in (0.01, -0.02):
        shop.drive(MotorCommand(TORQUE, torque), ms=1_000)
        assert shop.torque == pytest.approx(torque, abs=2e-5)  # half a step of a C610 is 2.5e-6, of a C620 1e-5


def turns_as_fast_as_its_voltage(shop: Shop) -> None:
    """What friction takes is the same at any speed, so each volt more is as much speed more."""
    speeds = []
    for voltage in (3.0, 6.0, 9.0, -6.0):
        shop.drive(MotorCommand(VOLTAGE, voltage), ms=6_000)
        speeds.append(shop.shaft.velocity)
    assert speeds[0] > 50.0
    assert speeds[2] - speeds[1] == pytest.approx(speeds[1] - speeds[0], rel=1e-3)
    assert speeds[3] == pytest.approx(-speeds[1], rel=1e-3)


def comes_to_rest(shop: Shop) -> None:
    """By its own speed loop within a second; shorted windings brake in proportion to the speed."""
    set_going(shop)
    shop.drive(BRAKE, ms=1_000 if shop.driver.capabilities[0].velocity else 4_000)
    assert abs(shop.shaft.velocity) < 1.0


def rolls_on_alone(shop: Shop) -> None:
    set_going(shop)
    shop.drive(COAST, ms=20)
    before = shop.shaft.velocity
    assert before > 50.0
    if not shop.driver.capabilities[0].coast:
        is_dragged_while_it_turns(shop, before)
        return
    shop.drive(COAST, ms=500)
    assert shop.torque == 0.0
    assert shop.shaft.velocity == pytest.approx(before - 0.5 * FRICTION / ON_THE_GROUND)


def is_dragged_while_it_turns(shop: Shop, before: float) -> None:
    shop.work = 0.0
    shop.drive(COAST, ms=500)
    assert shop.torque < -FRICTION
    assert 0.0 < shop.shaft.velocity < before - FRICTION / ON_THE_GROUND
    shop.drive(COAST, ms=4_000)
    assert shop.shaft.velocity == shop.torque == 0.0
    assert shop.work == 0.0


def set_going(shop: Shop) -> None:
    kind = kind_of(shop.driver)
    shop.arm(kind, 200.0 if kind is VELOCITY else GOING[kind])


OBEYED: dict[CommandKind, Callable[[Shop], None]] = {
    CommandKind.VELOCITY: reaches_its_velocity,
    CommandKind.TORQUE: gives_its_torque,
    CommandKind.VOLTAGE: turns_as_fast_as_its_voltage,
    CommandKind.BRAKE: comes_to_rest,
    CommandKind.COAST: rolls_on_alone,
}


def shop_of(driver: str, variant: str) -> Shop:
    return Shop(driver, variant, inertia=ON_THE_GROUND, speed=0.0)


@every_variant
@pytest.mark.parametrize("kind", CommandKind)
def test_every_kind_claimed_is_obeyed_and_every_other_refused(driver: str, variant: str, kind: CommandKind) -> None:
    shop = shop_of(driver, variant)
    (able,) = shop.driver.capabilities
    if kind in claimed(able):
        OBEYED[kind](shop)
        return
    for _ in range(2):
        with pytest.raises(ValueError, match="motor_1"):
            shop.driver.command([MotorCommand(kind)], now_ns=shop.now_ns)
        shop.drive(MotorCommand(kind_of(shop.driver)), ms=1_000)


@every_variant
def test_a_feed_forward_is_felt_at_the_shaft_at_once(driver: str, variant: str) -> None:
    shop = shop_of(driver, variant)
    if not shop.driver.capabilities[0].feed_forward:
        return
    for helping in (0.05, -0.05):
        shop.drive(MotorCommand(VELOCITY, 200.0), ms=2_000)
        before = shop.torque
        shop.say(shop.driver.command([MotorCommand(VELOCITY, 200.0, helping)], now_ns=shop.now_ns))
        shop.run(1)
        assert shop.torque - before == pytest.approx(helping, abs=1e-3)
        shop.drive(MotorCommand(VELOCITY, 200.0, helping), ms=2_000)
        assert shop.shaft.velocity == pytest.approx(200.0, rel=1e-3), "the speed loop takes it back"


@every_variant
def test_a_limit_is_kept_in_every_step(driver: str, variant: str) -> None:
    shop = shop_of(driver, variant)
    if not shop.driver.capabilities[0].limit:
        return
    shop.drive(MotorCommand(VELOCITY), ms=2_000)
    shop.most = 0.0
    shop.drive(MotorCommand(VELOCITY, 200.0, limit=0.03), ms=1_000)
    assert shop.most == pytest.approx(0.03, rel=1e-3)  # as on the wire
    shop.drive(MotorCommand(VELOCITY, 200.0), ms=2_000)
    assert shop.shaft.velocity == pytest.approx(200.0, rel=1e-3), "the limit ends with its command"
