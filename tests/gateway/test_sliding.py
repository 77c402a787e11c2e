"""A robot whose wheels are locked on a slippery floor slides on: it is held until it cannot any more."""

from math import hypot

import pytest

from gateway.core.standstill import REST_DWELL_NS, SLIDING, STILL, Standstill
from gateway.types import Mode, RequestKind, Twist
from tests.world import World

MOST = 0.1  # m/s of the true body when its motors are let go


@pytest.mark.parametrize("floor", [0.12, 0.2, 0.3])
@pytest.mark.parametrize("stopped", [False, True])
def test_it_is_not_let_go_while_it_slides(floor: float, *, stopped: bool) -> None:
    """Its ramp is far beyond the floor, so that wheels stand long before the body does."""
    world = World(
        "omni4",
        edit=lambda text: text.replace("acceleration = { vx = 2.0, vy = 1.5,", "acceleration = { vx = 9.0, vy = 9.0,"),
    )
    world.bus.robot.set_floor(floor)
    world.start()
    world.run(4.0, Twist(1.4, 0.0, 0.0))
    assert world.bus.robot.truth.twist.vx > 1.0
    if stopped:
        world.request(RequestKind.ESTOP)
    world.run(6.0, until=lambda outputs: outputs.trace.wheel_setpoints == (None,) * 4)
    assert world.last.mode is (Mode.ESTOP if stopped else Mode.IDLE)
    assert hypot(*world.bus.robot.truth.twist[:2]) < MOST


def test_what_it_may_slide_with_falls_as_slowly_as_on_the_worst_floor() -> None:
    standstill, now_ns = Standstill(), 0
    standstill.slide(1.0, now_ns)
    held_s = (1.0 - STILL) / SLIDING
    for now_ns in range(0, 3_000_000_000, 4_000_000):
        standstill.measure(turning=False, measurable=True, now_ns=now_ns)
        standstill.command(braking=True, now_ns=now_ns)
        standstill.slide(0.0, now_ns)
        assert standstill.rested(now_ns) == (now_ns >= max(held_s * 1e9 - 1.0, REST_DWELL_NS))
