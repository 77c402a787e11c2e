"""Stop frames, sent again and again, against the simulated motors: rest without a speed loop of the host."""

from struct import pack, unpack

import pytest

from drivers.contract import CanFrame
from drivers.dji import FULL_BRAKING_NS, DjiDriver
from drivers.setpoint import CommandKind, MotorCommand
from replay.sim.controllers.contract import Shaft
from tests.drivers.rig import BUS, MS, UNDER_CONTRACT, spec
from tests.drivers.shop import GOING, LIFTED, ON_THE_GROUND, Shop, kind_of

every_variant = pytest.mark.parametrize(("driver", "variant"), UNDER_CONTRACT)
PERIODS = (2, 4, 10, 20, 100)  # ms; loops of 500 to 10 Hz


@every_variant
@pytest.mark.parametrize("period_ms", PERIODS)
@pytest.mark.parametrize("inertia", [ON_THE_GROUND, LIFTED])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_stop_frames_bring_a_running_motor_to_rest(
    driver: str, variant: str, period_ms: int, inertia: float, direction: float
) -> None:
    shop = Shop(driver, variant, inertia=inertia, speed=0.0, period_ms=period_ms)
    kind = kind_of(shop.driver)
    shop.arm(kind, direction * GOING[kind])
    running, shop.work = abs(shop.shaft.velocity), 0.0
    assert running > 50.0
    shop.stop(ms=4_000 if period_ms < 20 else 12_000)  # the longer a current may be held, the weaker it is
    assert abs(shop.shaft.velocity) < 2.0
    assert shop.work < 0.02 * 0.5 * inertia * running**2 + 1e-5  # never the other way round


@every_variant
@pytest.mark.parametrize("period_ms", PERIODS)
def test_stop_frames_never_drive_a_motor_that_stands(driver: str, variant: str, period_ms: int) -> None:
    shop = Shop(driver, variant, inertia=LIFTED, speed=0.0, period_ms=period_ms)
    for _ in range(2):
        shop.stop(ms=1_000)
        assert shop.shaft == Shaft(0.0, 0.0)
        shop.arm(kind_of(shop.driver), 0.0)


def test_braking_is_no_coasting() -> None:
    """From 600 rad/s on the ground: friction alone takes 33 s to stop it, full braking torque 0.29 s."""
    shop = Shop("dji", "c620", inertia=ON_THE_GROUND, speed=600.0)
    shop.run(4)
    shop.stop(ms=900)
    assert abs(shop.shaft.velocity) < 2.0


def dji(*, rpm: int, at: int = 0, command_rate: float = 250.0) -> DjiDriver:
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(max_speed=900.0, command_rate=command_rate)])
    assert driver.receive(CanFrame(BUS, 0x201, pack(">HhhBB", 0, rpm, 0, 30, 0), received_ns=at))
    return driver


def braking(driver: DjiDriver, now_ns: int) -> int:
    (frame,) = driver.stop_frames(now_ns=now_ns)
    raw, *others = unpack(">4h", frame.data)
    assert others == [0, 0, 0]
    return int(raw)


def test_the_braking_current_is_against_the_speed_in_proportion_and_saturates() -> None:
    full = braking(dji(rpm=-8000), MS)
    assert full == 16384
    for rpm, share in ((2148, 1.0), (1074, 0.5), (214, 0.1), (18, 18 / 2148.6), (17, 0.0), (1, 0.0), (0, 0.0)):
        assert braking(dji(rpm=rpm), MS) == pytest.approx(-share * full, abs=8)
        assert braking(dji(rpm=-rpm), MS) == -braking(dji(rpm=rpm), MS)


def test_nothing_brakes_blindly() -> None:
    assert braking(DjiDriver(BUS, [spec("c620", id=1)]), MS) == 0
    driver = dji(rpm=5000)
    assert braking(driver, 50 * MS - 1) != 0
    assert braking(driver, 50 * MS) == 0


@pytest.mark.parametrize("held_ns", [2 * FULL_BRAKING_NS, 8 * FULL_BRAKING_NS])
def test_what_is_held_for_long_or_measured_long_ago_brakes_less(held_ns: int) -> None:
    full = braking(dji(rpm=1000), FULL_BRAKING_NS)
    assert braking(dji(rpm=1000), held_ns) == pytest.approx(full * FULL_BRAKING_NS / held_ns, abs=1)
    driver = dji(rpm=1000)
    driver.command([MotorCommand(CommandKind.TORQUE, 0.0)], now_ns=0)
    driver.receive(CanFrame(BUS, 0x201, pack(">HhhBB", 0, 1000, 0, 30, 0), received_ns=held_ns))
    assert braking(driver, held_ns) == pytest.approx(full * FULL_BRAKING_NS / held_ns, abs=1)


def test_a_slow_loop_brakes_less_from_its_first_frame_on() -> None:
    assert braking(dji(rpm=1000, command_rate=50.0), MS) == pytest.approx(braking(dji(rpm=1000), MS) / 4, abs=1)
