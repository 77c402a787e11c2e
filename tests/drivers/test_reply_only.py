"""A whole robot whose motors speak only when spoken to, behind the real core."""

import re

import pytest

from drivers import DRIVERS
from gateway.types import ZERO_TWIST, Mode, Twist
from replay.sim.robot import CONTROLLERS
from tests.drivers.reply_only import ReplyOnlyDriver, SimulatedReplier
from tests.world import World

FORWARD = Twist(0.4, 0.0, 0.0)


def edit(text: str) -> str:
    """Omni4 with other controllers."""
    text = text.replace('driver = "dji"', 'driver = "reply_only"').replace('variant = "c620"', 'variant = "replier"')
    return re.sub(r"(?m)^(feedback_rate|speed_loop) = .*\n", "", text)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    monkeypatch.setitem(DRIVERS, "reply_only", ReplyOnlyDriver)
    monkeypatch.setitem(CONTROLLERS, "reply_only", SimulatedReplier)
    return World("omni4", edit=edit)


def test_it_starts_drives_and_comes_to_rest(world: World) -> None:
    world.start()
    world.run(2.0, FORWARD)
    assert world.bus.robot.truth.twist == pytest.approx(FORWARD, abs=0.02)
    assert world.last.trace.measured == pytest.approx(FORWARD, abs=0.02)
    world.run(3.0, ZERO_TWIST)
    assert world.true_speed() < 0.01
    assert world.is_in(Mode.DRIVE)


def test_a_motor_that_no_longer_replies_is_silent_and_the_others_drive_on(world: World) -> None:
    world.start()
    world.run(2.0, FORWARD)
    lost = world.config.motors_in_order()[1].name
    world.bus.robot.devices[lost].power_off()
    world.run(0.1, FORWARD)
    assert world.is_in(Mode.DEGRADED)
    assert [event.text for event in world.events if event.code == "fault_silent"] == [f"{lost}: silent for 0.06 s"]
    world.run(1.0, FORWARD)
    assert world.bus.robot.truth.twist == pytest.approx(FORWARD, abs=0.02)


def test_the_loop_may_stall_without_a_motor_being_silent(world: World) -> None:
    world.start()
    world.run(2.0, FORWARD)
    world.loop.pause(world.now_ns + 100_000_000)
    world.run(0.5, FORWARD)
    assert "fault_silent" not in world.codes()
