"""Laws of the moving setpoint: within every limit, along the straight line, arriving exactly, without overshoot."""

import itertools
from math import atanh, isclose, sqrt

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.control.limits import (
    _TURNING_DELAY,
    TURNING_SHARE,
    TwistLimiter,
    scale_to,
    stopping_time,
    turning_excess,
)
from gateway.types import ZERO_TWIST, Twist

limits = st.tuples(*[st.floats(0.2, 5.0)] * 3).map(lambda values: Twist(*values))
jerks = st.tuples(*[st.floats(1.0, 50.0)] * 3).map(lambda values: Twist(*values))
shares = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
periods = st.sampled_from([0.002, 0.004, 0.01])


def limiter(velocity: Twist, acceleration: Twist, jerk: Twist) -> TwistLimiter:
    return TwistLimiter(velocity=velocity, acceleration=acceleration, jerk=jerk)


def walk(moving: TwistLimiter, target: Twist, dt: float) -> list[Twist]:
    """Setpoints until nothing changes any more."""
    setpoints = [moving.setpoint]
    for _ in range(100_000):
        setpoint, active = moving.step(target, dt)
        setpoints.append(setpoint)
        if "acceleration" not in active and setpoints[-1] == setpoints[-2]:
            return setpoints
    pytest.fail("never arrives")


@settings(max_examples=25, deadline=None)
@given(limits, limits, jerks, st.lists(shares, min_size=1, max_size=3), periods)
def test_every_limit_holds_on_every_step(
    velocity: Twist, acceleration: Twist, jerk: Twist, targets: list[tuple[float, ...]], dt: float
) -> None:
    moving = limiter(velocity, acceleration, jerk)
    before, rate = moving.setpoint, ZERO_TWIST
    for target in targets:
        for _ in range(200):
            setpoint, _ = moving.step(Twist(*target), dt)
            new_rate = Twist(*((s - b) / dt for s, b in zip(setpoint, before, strict=True)))
            for axis in range(3):
                assert abs(setpoint[axis]) <= velocity[axis] * (1 + 1e-9)
                assert abs(new_rate[axis]) <= acceleration[axis] * (1 + 1e-6) + 1e-9
            before, rate = setpoint, new_rate
    assert rate is not None


@settings(max_examples=25, deadline=None)
@given(limits, limits, jerks, shares, periods)
def test_from_rest_straight_to_the_target_without_overshoot(
    velocity: Twist, acceleration: Twist, jerk: Twist, share: tuple[float, ...], dt: float
) -> None:
    moving = limiter(velocity, acceleration, jerk)
    target = Twist(*(s * v for s, v in zip(share, velocity, strict=True)))
    goal = scale_to(target, velocity)
    turning = turning_excess(goal, acceleration)
    if turning > 1.0:
        goal = Twist(*(value / sqrt(turning) for value in goal))
    setpoints = walk(moving, target, dt)
    assert setpoints[-1] == pytest.approx(goal, abs=1e-12)
    largest = max(range(3), key=lambda axis: abs(goal[axis]))
    rates = []
    for before, after in itertools.pairwise(setpoints):
        progress = after[largest] / goal[largest] if goal[largest] else 0.0
        assert -1e-9 <= progress <= 1 + 1e-9
        for axis in range(3):
            assert isclose(after[axis], progress * goal[axis], abs_tol=1e-6 * velocity[axis])
        rates.append([(a - b) / dt for a, b in zip(after, before, strict=True)])
    for before_rate, after_rate in zip([[0.0] * 3, *rates], [*rates, [0.0] * 3], strict=True):
        for axis in range(3):
            assert abs(after_rate[axis] - before_rate[axis]) <= jerk[axis] * dt * (1 + 1e-6) + 1e-9


def test_takes_the_time_physics_needs() -> None:
    """0 to 1 m/s at 1 m/s^2 with 5 m/s^3: v/a + a/j = 1.2 s."""
    moving = limiter(Twist(2, 2, 2), Twist(1, 1, 1), Twist(5, 5, 5))
    steps = len(walk(moving, Twist(1, 0, 0), 0.001))
    assert steps * 0.001 == pytest.approx(1.2, abs=0.01)


def test_names_the_limits_at_work() -> None:
    moving = limiter(Twist(1, 1, 1), Twist(1, 1, 1), Twist(5, 5, 5))
    assert moving.step(Twist(3, 0, 0), 0.004)[1] == ("velocity", "acceleration")
    walk(moving, Twist(0.5, 0, 0), 0.004)
    assert moving.step(Twist(0.5, 0, 0), 0.004)[1] == ()


def test_half_effort_takes_twice_the_acceleration_time() -> None:
    full, half = (limiter(Twist(2, 2, 2), Twist(1, 1, 1), Twist(1000, 1000, 1000)) for _ in range(2))
    for _ in range(100):
        full.step(Twist(2, 0, 0), 0.004)
        half.step(Twist(2, 0, 0), 0.004, effort=0.5)
    assert half.setpoint.vx == pytest.approx(full.setpoint.vx / 2, rel=0.02)


def test_velocity_limit_scales_the_whole_vector() -> None:
    assert scale_to(Twist(2.0, 1.0, 0.5), Twist(1.0, 10.0, 10.0)) == Twist(1.0, 0.5, 0.25)


def brakes_in_time(velocity: Twist, acceleration: Twist, jerk: Twist, start: Twist, dt: float) -> bool:
    """Brakes from a holdable twist; whether within the stopping time. No axis may grow on the way."""
    turning = turning_excess(start, acceleration)
    moving = limiter(velocity, acceleration, jerk)
    moving.reset(start if turning <= 1.0 else Twist(*(value / sqrt(turning) for value in start)))
    bound = stopping_time(velocity=velocity, acceleration=acceleration, jerk=jerk)
    for _ in range(int(bound / dt) + 3):  # steps of a period, so up to that much later
        before = moving.setpoint
        after = moving.brake(dt)
        assert all(abs(new) <= abs(old) for new, old in zip(after, before, strict=True))
    return moving.at_rest


@settings(max_examples=100, deadline=None)
@given(limits, limits, jerks, st.tuples(*[st.floats(-1.0, 1.0)] * 3), periods)
def test_brakes_to_rest_within_the_stopping_time(
    velocity: Twist, acceleration: Twist, jerk: Twist, share: tuple[float, ...], dt: float
) -> None:
    start = Twist(*(s * v for s, v in zip(share, velocity, strict=True)))
    assert brakes_in_time(velocity, acceleration, jerk, start, dt)


def test_brakes_in_time_where_a_curve_meets_a_ramp_too_short_for_full_acceleration() -> None:
    assert brakes_in_time(Twist(1, 1, 1), Twist(2, 2, 3), Twist(1, 1, 1), Twist(1, 1, 1), 0.004)


def test_the_delay_of_turning_is_that_of_its_share() -> None:
    """Written out in the code, because atanh is not the same on every CPU."""
    assert pytest.approx(atanh(sqrt(0.7)) / sqrt(0.7), rel=1e-15) == _TURNING_DELAY
    assert TURNING_SHARE == 0.7
