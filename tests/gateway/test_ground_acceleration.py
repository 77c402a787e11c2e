"""What the floor feels stays within the acceleration limits, turning included; what holds the setpoint back."""

from itertools import pairwise
from math import hypot

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.control.limits import TwistLimiter, excess, turning_excess
from gateway.types import ZERO_TWIST, Rates, Twist

DT = 0.004
# The limits of the bundled robots: velocity, acceleration, jerk.
OMNI4 = (Twist(2.0, 1.5, 4.0), Twist(2.0, 1.5, 6.0), Twist(15.0, 12.0, 40.0))
MOBY = (Twist(1.2, 1.2, 1.0), Twist(0.8, 0.8, 1.0), Twist(4.0, 4.0, 5.0))
# dv/dt gives way to a growing w x v only as fast as the jerk limits let it: where a command changes in the middle of a
# ramp the sum is above the limit for some hundredths of a second, by 10 % (omni4) and 6 % (moby) at most in a
# thousand random drives of each.
TRANSIENT = 1.15

shares = st.one_of(st.just(0.0), st.floats(-1.3, 1.3))
legs = st.lists(st.tuples(st.tuples(shares, shares, shares), st.integers(5, 250)), min_size=1, max_size=6)


def limiter(limits: tuple[Twist, Twist, Twist]) -> TwistLimiter:
    velocity, acceleration, jerk = limits
    return TwistLimiter(velocity=velocity, acceleration=acceleration, jerk=jerk)


def over_the_ground(before: Rates, after: Rates) -> Twist:
    """Acceleration of the body in its own axes: dv/dt + w x v."""
    vx, vy, wz = (0.5 * (a + b) for a, b in zip(before, after, strict=True))
    ax, ay, az = ((a - b) / DT for a, b in zip(after, before, strict=True))
    return Twist(ax - wz * vy, ay + wz * vx, az)


@pytest.mark.parametrize("limits", [OMNI4, MOBY], ids=["omni4", "moby"])
@settings(max_examples=40, deadline=None)
@example(course=[((1.0, 0.0, 1.0), 250), ((0.0, 1.0, 1.0), 250), ((1.0, 0.0, 0.0), 250)])
@given(course=legs)
def test_the_acceleration_over_the_ground_stays_within_its_limits(
    limits: tuple[Twist, Twist, Twist], course: list[tuple[tuple[float, float, float], int]]
) -> None:
    moving = limiter(limits)
    for share, steps in course:
        target = Twist(*(part * top for part, top in zip(share, limits[0], strict=True)))
        for _ in range(steps):
            before = moving.setpoint
            after, _ = moving.step(target, DT)
            assert excess(over_the_ground(before, after), limits[1]) <= TRANSIENT


def test_in_a_steady_curve_speeding_up_gets_what_turning_leaves() -> None:
    """At 0.7 m/s and 1.5 rad/s w x v is 1.05 m/s^2 of 1.5 across; the way across gets 0.45, outward all of 1.5."""
    for across, most in ((1.0, 0.45), (-1.0, 1.5)):
        moving = limiter(OMNI4)
        moving.reset(Twist(0.7, 0.0, 1.5))
        rates = []
        for _ in range(40):
            before = moving.setpoint
            after, _ = moving.step(Twist(0.7, across, 1.5), DT)
            rates.append(abs(after[1] - before.vy) / DT)
        assert max(rates) == pytest.approx(most, rel=0.02)


def test_a_twist_beyond_the_turning_limit_is_shortened_to_its_edge() -> None:
    """2 m/s at 4 rad/s is 8 m/s^2 across where 0.7 of 1.5 may be: both shrink by the root of 7.62."""
    moving = limiter(OMNI4)
    for _ in range(1500):
        _, active = moving.step(Twist(2.0, 0.0, 4.0), DT)
    assert moving.setpoint == pytest.approx((0.7246, 0.0, 1.4491), abs=1e-3)
    assert active == ("turning",)


def test_between_two_twists_on_the_edge_the_way_leads_along_it() -> None:
    """Fast and hardly turning to slow and turning fast: straight across would be 2.4 times the turning limit."""
    moving = limiter(OMNI4)
    fast, spinning = Twist(2.0, 0.0, 0.525), Twist(0.2625, 0.0, 4.0)
    worst = 0.0
    for target in (fast, spinning, fast):
        for _ in range(1000):
            moving.step(target, DT)
            worst = max(worst, turning_excess(moving.setpoint, OMNI4[1]))
        assert moving.setpoint == pytest.approx(target, abs=1e-6)
    assert worst < 1.1


def test_without_headroom_the_setpoint_does_not_grow_and_still_shrinks() -> None:
    moving = limiter(OMNI4)
    start = Twist(0.8, -0.4, 0.6)
    moving.reset(start)
    for _ in range(50):
        moving.step(Twist(2.0, -1.0, 1.5), DT, headroom=0.0)
    assert moving.setpoint == start
    after, _ = moving.step(Twist(2.0, -1.0, 1.5), DT)
    assert 0.0 < after[0] - start.vx <= 15.0 * DT * DT * 1.001, "no leap once there is room again: jerk 15 m/s^3"
    for _ in range(1000):
        moving.step(ZERO_TWIST, DT, headroom=0.0)
    assert moving.at_rest


def test_half_the_headroom_is_half_the_growth() -> None:
    full, half = limiter(OMNI4), limiter(OMNI4)
    full.step(Twist(2.0, 0.0, 0.0), DT)
    half.step(Twist(2.0, 0.0, 0.0), DT, headroom=0.5)
    assert half.setpoint.vx == pytest.approx(0.5 * full.setpoint.vx)


def test_effort_bounds_every_axis_of_the_acceleration() -> None:
    moving = limiter(OMNI4)
    steepest = [0.0, 0.0, 0.0]
    for target in (Twist(1.0, 0.0, 0.0), ZERO_TWIST, Twist(0.0, 1.0, 0.0), ZERO_TWIST, Twist(0.0, 0.0, 4.0)):
        for _ in range(600):
            before = moving.setpoint
            after, _ = moving.step(target, DT, effort=0.5)
            steepest = [max(s, abs(a - b) / DT) for s, a, b in zip(steepest, after, before, strict=True)]
    assert steepest == pytest.approx([1.0, 0.75, 3.0], rel=1e-3)


def test_braking_in_the_middle_of_a_ramp_drops_what_led_elsewhere() -> None:
    """It was speeding up along y when silence came: no axis grows in the very next period, and the way is straight."""
    moving = limiter(OMNI4)
    moving.reset(Twist(1.0, 0.2, 0.3))
    for _ in range(60):
        moving.step(Twist(1.0, 1.4, 0.3), DT)
    start = moving.setpoint
    assert start.vy > 0.3
    speeds: list[Rates] = [start]
    while not moving.at_rest:
        speeds.append(moving.brake(DT))
        assert len(speeds) < 1000
    for before, after in pairwise(speeds):
        assert all(abs(new) <= abs(old) for new, old in zip(after, before, strict=True))
        assert after[0] * start.vy == pytest.approx(after[1] * start.vx, abs=1e-9)
    # Jerk 15 m/s^3 along x, 12 along y: the first periods of braking are gentle, not a step.
    first = [hypot(b[0] - a[0], b[1] - a[1]) / DT for a, b in pairwise(speeds[:4])]
    assert first == pytest.approx([0.07, 0.14, 0.21], abs=0.03)


def test_braking_goes_on_as_steeply_as_the_ramp_already_fell() -> None:
    moving = limiter(OMNI4)
    moving.reset(Twist(1.6, 0.0, 0.0))
    for _ in range(60):
        before = moving.setpoint
        after, _ = moving.step(ZERO_TWIST, DT)
    assert before.vx - after[0] == pytest.approx(2.0 * DT)
    assert after[0] - moving.brake(DT)[0] == pytest.approx(2.0 * DT)
