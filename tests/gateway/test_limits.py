"""The moving setpoint, by laws and by figures: within every limit, straight on, arriving exactly, without overshoot."""

import itertools
from math import atanh, isclose, sqrt
from operator import mul

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.control.limits import (
    _TURNING_DELAY,
    TURNING_SHARE,
    TwistLimiter,
    excess,
    scale_to,
    stopping_distance,
    stopping_time,
    turning_excess,
)
from gateway.types import ZERO_TWIST, Rates, Twist

limits = st.tuples(*[st.floats(0.2, 5.0)] * 3).map(lambda values: Twist(*values))
jerks = st.tuples(*[st.floats(1.0, 50.0)] * 3).map(lambda values: Twist(*values))
shares = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
periods = st.sampled_from([0.002, 0.004, 0.01])


def limiter(velocity: Twist, acceleration: Twist, jerk: Twist) -> TwistLimiter:
    return TwistLimiter(velocity=velocity, acceleration=acceleration, jerk=jerk)


def walk(moving: TwistLimiter, target: Twist, dt: float) -> list[Rates]:
    """Setpoints until nothing changes any more."""
    setpoints = [moving.rates]
    for _ in range(100_000):
        setpoint, active = moving.step(target, dt)
        setpoints.append(setpoint)
        if "acceleration" not in active and setpoints[-1] == setpoints[-2]:
            return setpoints
    pytest.fail("never arrives")


@settings(max_examples=50, deadline=None)
@given(limits, limits, jerks, st.lists(st.tuples(shares, st.integers(1, 200)), min_size=1, max_size=4), periods)
@example(Twist(1.0, 0.5, 1.0), Twist(1, 1, 1), Twist(5, 5, 5), [((1.5, -1.5, 0.0), 60), ((-2.0, -2.0, 1.0), 200)], 0.01)
@example(Twist(3.0, 0.3, 1.0), Twist(3, 2, 1), Twist(3, 3, 3), [((2.0, 1.5, 0.0), 120), ((-2.0, 2.0, 0.0), 200)], 0.01)
def test_every_limit_holds_on_every_step(
    velocity: Twist, acceleration: Twist, jerk: Twist, targets: list[tuple[tuple[float, ...], int]], dt: float
) -> None:
    """However targets jump meanwhile, also of an axis that has little room left to its top speed."""
    moving = limiter(velocity, acceleration, jerk)
    before, rate = moving.rates, moving.rates
    for share, steps in targets:
        for _ in range(steps):
            setpoint, _ = moving.step(Twist(*map(mul, share, velocity)), dt)
            new_rate = tuple((s - b) / dt for s, b in zip(setpoint, before, strict=True))
            change = tuple((new - old) / dt for new, old in zip(new_rate, rate, strict=True))
            for of, held in ((setpoint, velocity), (new_rate, acceleration), (change, jerk)):
                assert excess(of, held) <= 1 + 1e-5
            before, rate = setpoint, new_rate


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


# figures by hand

TOP, ACCELERATION = Twist(10, 10, 10), Twist(2, 4, 8)
SOFT, HARD = Twist(1, 4, 16), Twist(50, 50, 50)  # jerk; soft: 0.5/s of the acceleration limit along x


@pytest.mark.parametrize(
    ("vector", "limits", "expected"),
    [
        (Twist(-2, 1, 0.5), Twist(1, 10, 10), 2.0),
        (Twist(0.5, -3, 0), Twist(1, 2, 1), 1.5),
        (Twist(0, 1, -3), Twist(1, 4, 4), 0.75),
    ],
)
def test_excess_is_that_of_the_worst_axis(vector: Twist, limits: Twist, expected: float) -> None:
    assert excess(vector, limits) == expected


@pytest.mark.parametrize(
    ("twist", "expected"),
    [(Twist(1, -2, -3), 3 * 0.5 / 0.7), (Twist(-4, 0.5, 3), 3 * 0.8 / 0.7), (Twist(5, 5, 0), 0.0)],
)
def test_turning_takes_seven_tenths_of_the_acceleration_across(twist: Twist, expected: float) -> None:
    assert turning_excess(twist, Twist(4, 5, 1)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("velocity", "jerk", "time", "distance"),
    [
        (Twist(3, 4, 1), Twist(5, 20, 5), 3.2 * 1.4461491, 8.0 * 1.4461491),  # L = 3, 1/rho = 0.2
        (Twist(0.1, 0, 0), Twist(0.5, 9, 1), 0.8944272 * 1.4461491, 0.0447214 * 1.4461491),  # 2 sqrt(0.1 * 2)
    ],
)
def test_stopping_follows_from_the_limits(velocity: Twist, jerk: Twist, time: float, distance: float) -> None:
    acceleration = Twist(1, 2, 1)
    assert stopping_time(velocity=velocity, acceleration=acceleration, jerk=jerk) == pytest.approx(time)
    assert stopping_distance(velocity=velocity, acceleration=acceleration, jerk=jerk) == pytest.approx(distance)


# start, target, jerk, dt, factors, setpoints
COURSES = {
    # In steps of 1 s: 1.5 s of full acceleration to go; the rate grows by 1, then falls by 1.
    "soft": (ZERO_TWIST, Twist(3, 0, 0), SOFT, 1.0, {}, [(1, 0, 0), (2.5, 0, 0), (3, 0, 0), (3, 0, 0)]),
    "soft, nearly a step more": (ZERO_TWIST, Twist(3.9, 0, 0), SOFT, 1.0, {}, [(1, 0, 0), (2.95, 0, 0), (3.9, 0, 0)]),
    "all axes": (ZERO_TWIST, Twist(9, 4.5, -0.9), HARD, 0.5, {}, [(1, 0.5, -0.1)]),
    "half effort": (ZERO_TWIST, Twist(9, 0, 0), HARD, 1.0, {"effort": 0.5}, [(1, 0, 0), (2, 0, 0)]),
    "headroom": (ZERO_TWIST, Twist(-9, 0, 0), SOFT, 1.0, {"headroom": 0.25}, [(-0.25, 0, 0), (-0.5625, 0, 0)]),
    "no headroom": (Twist(5, 0, 0), Twist(9, 0, 0), HARD, 1.0, {"headroom": 0.0}, [(5, 0, 0), (5, 0, 0)]),
    "no headroom, slower": (Twist(-5, 0, 0), Twist(-1, 0, 0), HARD, 1.0, {"headroom": 0.0}, [(-3, 0, 0), (-1, 0, 0)]),
    "little headroom, less": (Twist(5, 0, 0), Twist(3, 1, 0), HARD, 1.0, {"headroom": 0.25}, [(3, 0.25, 0)]),
    "no headroom, less": (Twist(0, -5, 0), Twist(-1, -3, 0), HARD, 1.0, {"headroom": 0.0}, [(0, -3, 0), (0, -3, 0)]),
    # In a curve 1 m/s^2 along y is taken: what pushes outwards has 4 - 1 = 3, inwards and along x all.
    "brake in a curve": (Twist(2, 0, 1), Twist(0, 0, 1), HARD, 0.1, {}, [(1.8, 0, 1), (1.6, 0, 1)]),
    "inwards": (Twist(1, 0, 1), Twist(1, -1, 1), HARD, 0.1, {}, [(1, -0.4, 1)]),
    "outwards": (Twist(1, 0, 1), Twist(1, 1, 1), HARD, 0.1, {}, [(1, 0.3, 1)]),
    "outwards, other turn": (Twist(1, 0, -1), Twist(1, -1, -1), HARD, 0.1, {}, [(1, -0.3, -1)]),
    "along x": (Twist(0, 1, 1), Twist(1, 1, 1), HARD, 0.1, {}, [(0.2, 1, 1)]),
    "against x": (Twist(0, 1, 1), Twist(-1, 1, 1), HARD, 0.1, {}, [(-0.1, 1, 1)]),
    "a fifth of 4 is left": (Twist(3.5, 0, 1), Twist(2.8, 1, 1), HARD, 0.1, {}, [(3.444, 0.08, 0.984)]),
    "other turn": (Twist(3.5, 0, -1), Twist(2.8, -1, -1), HARD, 0.1, {}, [(3.444, -0.08, -0.984)]),
    # Between two twists at the edge (2.8 = 0.7 * 4 along y, 1.4 along x): a line whose peak is 1.01 times that is
    # taken; of one whose peak is 1.03 times that only what falls.
    "line": (Twist(2, 0, 1.37), Twist(1.37, 0, 2), HARD, 0.1, {}, [(1.8, 0, 1.57)]),
    "line of y": (Twist(0, 1.5, 0.88), Twist(0, 0.88, 1.5), HARD, 0.1, {}, [(0, 1.1, 1.28)]),
    "slower": (Twist(2, 0, 1.385), Twist(1.385, 0, 2), HARD, 0.1, {}, [(1.8, 0, 1.385 + 0.2 * 0.015 / 0.615)]),
    "slower back": (Twist(-2, 0, 1.385), Twist(-1.385, 0, 2), HARD, 0.1, {}, [(-1.8, 0, 1.385 + 0.2 * 0.015 / 0.615)]),
    "slower right": (Twist(2, 0, -1.385), Twist(1.385, 0, -2), HARD, 0.1, {}, [(1.8, 0, -1.385 - 0.2 * 0.015 / 0.615)]),
    "straighter": (Twist(1.395, 0, 2), Twist(2, 0, 1.395), HARD, 0.1, {}, [(1.395 + 0.5 * 0.005 / 0.605, 0, 1.5)]),
    "straighter back": (
        *(Twist(-1.395, 0, -2), Twist(-2, 0, -1.395), HARD, 0.1, {}),
        [(-1.395 - 0.5 * 0.005 / 0.605, 0, -1.5)],
    ),
    "y slower": (Twist(0, -1.5, 0.93), Twist(0, -0.93, 1.5), HARD, 0.1, {}, [(0, -1.1, 0.93 + 0.4 * 0.01 / 1.71)]),
    "y straighter": (Twist(0, -0.93, -1.5), Twist(0, -1.5, -0.93), HARD, 0.1, {}, [(0, -0.93 - 0.5 * 0.01 / 1.71, -1)]),
    # The product of both has its extreme before the start, or behind the target: it does not count.
    "before": (Twist(1.395, 0, 2), Twist(0.1, 0, 2.1), HARD, 0.1, {}, [(1.195, 0, 2 + 0.2 * 0.1 / 1.295)]),
    "behind": (Twist(2.2975, 0, 1), Twist(1.827, 0, 1.531), HARD, 0.1, {}, [(2.0975, 0, 1 + 0.2 * 0.531 / 0.4705)]),
}


@pytest.mark.parametrize(("start", "target", "jerk", "dt", "factors", "course"), COURSES.values(), ids=COURSES)
def test_course(
    *, start: Twist, target: Twist, jerk: Twist, dt: float, factors: dict[str, float], course: list[tuple[float, ...]]
) -> None:
    moving = limiter(TOP, ACCELERATION, jerk)
    moving.reset(start)
    assert [
        moving.step(target, dt, effort=factors.get("effort", 1.0), headroom=factors.get("headroom", 1.0))[0]
        for _ in course
    ] == [pytest.approx(one, abs=1e-9) for one in course]


BRAKES = {
    "soft": (SOFT, Twist(4, 2, 1), 1.0, [0.9, 0.8, 0.62, 0.3122]),
    "x": (HARD, Twist(4, 0, 0), 1.0, [0.5, 0.0]),
    "y": (HARD, Twist(0, -8, 0), 1.0, [0.5, 0.0]),
    "z": (HARD, Twist(0, 0, 8), 0.5, [0.5, 0.0]),
    "all": (HARD, Twist(4, 2, -1), 0.5, [0.8]),
}


@pytest.mark.parametrize(("jerk", "start", "dt", "shares"), BRAKES.values(), ids=BRAKES)
def test_brakes_along_its_direction(jerk: Twist, start: Twist, dt: float, shares: list[float]) -> None:
    moving = limiter(TOP, ACCELERATION, jerk)
    moving.reset(start)
    assert [moving.brake(dt) for _ in shares] == [
        pytest.approx([share * axis for axis in start], abs=1e-9) for share in shares
    ]


def test_brakes_from_where_it_still_grew() -> None:
    moving = limiter(TOP, ACCELERATION, SOFT)
    seen = [moving.step(Twist(3, 0, 0), 1.0)[0] for _ in range(2)]
    seen += [moving.brake(1.0) for _ in range(3)]
    assert [one[0] for one in seen] == pytest.approx([1.0, 2.5, 1.5, 0.25, 0.0])
    assert moving.at_rest
    assert moving.step(ZERO_TWIST, 1.0) == (ZERO_TWIST, ())


def test_without_time_nothing_changes() -> None:
    moving = limiter(TOP, ACCELERATION, SOFT)
    moving.reset(Twist(2, 0, 0))
    for dt in (0.0, -1.0):
        assert moving.step(Twist(3, 0, 0), dt) == (Twist(2, 0, 0), ())
        assert moving.brake(dt) == Twist(2, 0, 0)


def test_limits_at_work_have_names() -> None:
    moving = limiter(TOP, ACCELERATION, SOFT)
    for target, names in (
        (Twist(11, 0, 0), ("velocity",)),
        (TOP._replace(wz=0.0), ()),
        (Twist(2, 0, 2.1), ("turning",)),
        (Twist(1.4, 0, 2), ()),
    ):
        assert moving.step(target, 0.0)[1] == names


def test_scaling_the_setpoint_scales_its_rate() -> None:
    moving = limiter(TOP, ACCELERATION, SOFT)
    for _ in range(2):
        moving.step(Twist(3, 0, 0), 1.0)
    moving.scale(0.5)
    assert moving.setpoint == Twist(1.25, 0, 0)
    assert moving.step(Twist(9, 0, 0), 1.0)[0][0] == 1.25 + 0.75 + 1.0
    moving.reset(Twist(1, 0, 0))
    assert not moving.at_rest
    assert moving.step(Twist(9, 0, 0), 1.0)[0][0] == 2.0


@pytest.mark.parametrize(("cycles", "after"), [(2, 4.5), (3, 4.5), (4, 4.0)])
def test_arrives_with_a_rate_that_it_loses_in_the_next_step(cycles: int, after: float) -> None:
    moving = limiter(TOP, ACCELERATION, SOFT)
    names = [moving.step(Twist(3, 0, 0), 1.0)[1] for _ in range(cycles)]
    assert names == [("acceleration",), ("acceleration",), (), ()][:cycles]
    assert moving.step(Twist(9, 0, 0), 1.0)[0][0] == after


@pytest.mark.parametrize("target", [2.6, 2.5, 2.5 + 1e-12, 2.4])
def test_what_cannot_stop_in_time_goes_past_its_target(target: float) -> None:
    """At 2.5 with 1.5 per step the next step is at least 0.5."""
    moving = limiter(TOP, ACCELERATION, SOFT)
    for _ in range(2):
        moving.step(Twist(3, 0, 0), 1.0)
    assert moving.step(Twist(target, 0, 0), 1.0) == (Twist(3, 0, 0), ("acceleration",))


@pytest.mark.parametrize(("jerk", "way"), [(SOFT, 1.0), (HARD, 2.0)])
def test_one_step_is_as_long_as_jerk_and_acceleration_allow(jerk: Twist, way: float) -> None:
    assert limiter(TOP, ACCELERATION, jerk).step(Twist(way, 0, 0), 1.0) == (Twist(way, 0, 0), ())
    assert limiter(TOP, ACCELERATION, jerk).step(Twist(1.01 * way, 0, 0), 1.0)[1] == ("acceleration",)


def test_half_steps() -> None:
    """Acceleration grows and falls by 0.5 m/s^2 in each of 0.5 s."""
    moving = limiter(TOP, ACCELERATION, SOFT)
    seen = [moving.step(Twist(1, 0, 0), 0.5)[0][0] for _ in range(4)]
    assert [*seen, moving.step(Twist(9, 0, 0), 0.5)[0][0]] == pytest.approx([0.25, 0.75, 1.0, 1.0, 1.25])
    moving.reset()
    seen = [moving.step(Twist(1, 0, 0), 0.5)[0][0] for _ in range(3)]
    assert [*seen, moving.step(Twist(9, 0, 0), 0.5)[0][0]] == pytest.approx([0.25, 0.75, 1.0, 1.5])


def test_brake_forgets_where_a_rate_led_but_not_how_fast_it_slowed_down() -> None:
    for targets, speeds in (
        ([ZERO_TWIST], [0.0, 0.0, 1.0]),
        ([Twist(-9, 0, 0)] * 2, [2.5, 0.5, 0.0, 1.0]),  # too fast to land: to rest, and not beyond
    ):
        moving = limiter(TOP, ACCELERATION, SOFT)
        moving.reset(Twist(1 if len(targets) == 1 else 3.5, 0, 0))
        seen = [moving.step(target, 1.0)[0][0] for target in targets]
        assert [*seen, moving.brake(1.0)[0], moving.step(Twist(9, 0, 0), 1.0)[0][0]] == speeds


@pytest.mark.parametrize("signs", [(1, 1, 1), (1, -1, -1)])
def test_brakes_a_rate_of_all_axes(signs: tuple[int, int, int]) -> None:
    moving = TwistLimiter(velocity=TOP, acceleration=Twist(1, 3, 5), jerk=Twist(1, 3, 5))
    moving.reset(Twist(0.4, 0.6 * signs[1], 0.5 * signs[2]))
    moving.step(Twist(0.1, -0.1 * signs[1], -0.2 * signs[2]), 0.1)
    for vx, vy, wz in ((0.36850507, 0.54488356, 0.45039508), (0.33701014, 0.49831413, 0.41190128)):
        assert moving.brake(0.1) == pytest.approx((vx, vy * signs[1], wz * signs[2]))


def test_the_delay_of_turning_is_that_of_its_share() -> None:
    """Written out in the code, because atanh is not the same on every CPU."""
    assert pytest.approx(atanh(sqrt(0.7)) / sqrt(0.7), rel=1e-15) == _TURNING_DELAY
    assert TURNING_SHARE == 0.7
