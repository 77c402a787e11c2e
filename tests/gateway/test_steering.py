"""Steering by a gyro: a law of its own, and what it makes of wheels that lose some of the turn."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.odd import SteeringConfig
from gateway.control.steering import FARTHEST, SHARE, Steering, SteeringGains
from gateway.types import Twist
from tests.world import World

GAINS = SteeringGains(2.0, 0.3)
SUDDEN = 1e6  # rad/s^2: whatever it adds, it adds at once


def test_it_adds_what_is_missing_and_how_fast() -> None:
    steering = Steering(GAINS, top=4.0, acceleration=SUDDEN)
    assert steering.steered(1.0, 0.9, 0.1) == pytest.approx(1.0 + 2.0 * 0.01 + 0.3 * 0.1)
    assert steering.steered(1.0, 1.0, 0.1) == pytest.approx(1.0 + 2.0 * 0.01)
    steering.forget()
    assert steering.steered(1.0, 1.0, 0.1) == 1.0


def test_without_a_gyro_it_is_as_told_and_forgets() -> None:
    steering = Steering(GAINS, top=4.0, acceleration=SUDDEN)
    steering.steered(1.0, 0.0, 0.05)
    assert steering.steered(1.0, None, 0.1) == 1.0
    assert steering.steered(1.0, 1.0, 0.1) == 1.0


@given(st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(-20.0, 20.0)), min_size=1, max_size=50))
def test_it_never_adds_more_than_its_share(course: list[tuple[float, float]]) -> None:
    steering = Steering(SteeringGains(20.0, 1.0), top=4.0, acceleration=SUDDEN)
    for wanted, measured in course:
        assert abs(steering.steered(wanted, measured, 0.1) - wanted) <= SHARE * 4.0 + 1e-12
    steering.steered(0.0, 0.0, 0.1)
    assert abs(steering.steered(0.0, 0.0, 0.1)) <= min(20.0 * FARTHEST, SHARE * 4.0) + 1e-12


@given(st.lists(st.tuples(st.floats(-5.0, 5.0), st.none() | st.floats(-20.0, 20.0)), min_size=1, max_size=50))
def test_what_it_adds_comes_and_goes_no_faster_than_the_body_may_turn_faster(
    course: list[tuple[float, float | None]],
) -> None:
    steering, added = Steering(SteeringGains(20.0, 1.0), top=4.0, acceleration=6.0), 0.0
    for wanted, measured in course:
        before, added = added, steering.steered(wanted, measured, 0.1) - wanted
        assert abs(added - before) <= 6.0 * 0.1 + 1e-12


@given(st.floats(-20.0, 20.0))
def test_without_a_gyro_what_it_added_is_gone_in_time(measured: float) -> None:
    steering = Steering(GAINS, top=4.0, acceleration=6.0)
    for gyro in (*[measured] * 5, *[None] * 3):  # by a quarter of 4 rad/s at most, 0.6 of it in each 0.1 s
        told = steering.steered(1.0, gyro, 0.1)
    assert told == 1.0


def settles(gains: SteeringGains, lag: float) -> bool:
    """Whether the missing turn ends without changing its sign, by small steps."""
    missing, rate, step = 0.1, 0.0, lag / 200.0
    for _ in range(20_000):
        told = gains.yaw * missing - gains.yaw_rate * rate
        rate += step * (told - rate) / lag
        missing -= step * rate
        if missing < -1e-4:
            return False
    return True


@pytest.mark.parametrize("yaw_rate", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("lag", [0.02, 0.1])
def test_the_bound_of_the_gain_is_that_of_a_loop_that_does_not_swing(yaw_rate: float, lag: float) -> None:
    most = (1.0 + yaw_rate) ** 2 / (4.0 * lag)
    for yaw, well in ((0.98 * most, True), (1.5 * most, False)):
        gains = SteeringGains(yaw, yaw_rate)
        assert (gains.objection(lag) is None) == well
        assert settles(gains, lag) == well
    with pytest.raises(ValueError, match=r"yaw = .*: must be at most"):
        SteeringConfig(yaw=1.5 * most, yaw_rate=yaw_rate, lag=lag)


def turned_by_oil(*, steered: bool) -> float:
    """Rad off its heading, of a robot that speeds up with one outer wheel in oil."""
    world = World(
        "odd",
        edit=str
        if steered
        else lambda text: text.replace("yaw = 2.0 ", "yaw = 1e-9 ").replace("yaw_rate = 0.3", "yaw_rate = 0.0"),
    )
    world.start()
    world.bus.robot.set_friction("outer_left", 0.02)
    world.run(2.0, Twist(1.5, 0.0, 0.0))
    return abs(world.bus.robot.truth.pose.theta)


def test_oil_under_a_wheel_turns_it_less() -> None:
    without, by_gyro = turned_by_oil(steered=False), turned_by_oil(steered=True)
    assert without > 0.05
    assert by_gyro < 0.3 * without
