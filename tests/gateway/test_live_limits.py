"""Limits that a person changes while it drives: never beyond the robot file's, no jump, and no stop is weaker."""

from itertools import pairwise
from math import sqrt
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.control.decoupled import Decoupled, Saturation
from gateway.control.limits import NO_EASE, Ease, TwistLimiter, excess, landing_slope
from gateway.control.wheel_limits import WheelLimits
from gateway.types import Mode, Rates, Request, RequestKind, Twist
from tests.gateway.test_snapshot import goes_on_byte_for_byte
from tests.world import NAMES, World

PERIOD = 0.004
SAME = 1 + 1e-9

vectors = st.tuples(*[st.floats(0.5, 5.0)] * 3)
jerks = st.tuples(*[st.floats(2.0, 50.0)] * 3)
shares = st.tuples(*[st.floats(-1.5, 1.5)] * 3)
eases = st.builds(Ease, st.floats(0.05, 1.0), st.floats(0.05, 1.0))
# What is commanded, with which ease, for how many cycles.
stretches = st.lists(st.tuples(shares, eases, st.integers(1, 120)), min_size=1, max_size=8)
kinds = st.sampled_from(list(Saturation))


def limiter(kind: Saturation, velocity: Rates, acceleration: Rates, jerk: Rates) -> TwistLimiter:
    course = None
    if kind is not Saturation.BOTH:
        wheels = WheelLimits(((1.0, -1.0, -0.4), (1.0, 1.0, 0.4), (1.0, 0.0, 1.0)), speeds=(20.0, 20.0, 20.0))
        course = Decoupled(kind, velocity=velocity, acceleration=acceleration, jerk=jerk, wheels=wheels)
    return TwistLimiter(velocity=velocity, acceleration=acceleration, jerk=jerk, course=course)


def scaled_by(share: tuple[float, ...], velocity: Rates) -> Rates:
    return tuple(one * limit for one, limit in zip(share, velocity, strict=True))


def between(before: Rates, after: Rates) -> Rates:
    return tuple((a - b) / PERIOD for a, b in zip(after, before, strict=True))


@settings(max_examples=50, deadline=None)
@given(kinds, vectors, vectors, jerks, stretches)
def test_no_change_of_a_limit_is_a_jump(
    kind: Saturation,
    velocity: Rates,
    acceleration: Rates,
    jerk: Rates,
    drive: list[tuple[tuple[float, ...], Ease, int]],
) -> None:
    """Whatever is commanded and set: within velocity, acceleration and jerk of the robot file in every cycle."""
    moving = limiter(kind, velocity, acceleration, jerk)
    rate: Rates = (0.0, 0.0, 0.0)
    for share, ease, cycles in drive:
        for _ in range(cycles):
            before = moving.rates
            after, _ = moving.step(scaled_by(share, velocity), PERIOD, ease=ease)
            new = between(before, after)
            assert excess(after, velocity) <= SAME
            assert excess(new, acceleration) <= 1 + 1e-6
            # Where top speed cuts the step the file's own limits make the same corner; there is none from below.
            if excess(after, velocity) < 1 - 1e-9:
                change = [n - r for n, r in zip(new, rate, strict=True)]
                assert excess(tuple(change), jerk) <= PERIOD * (1 + 1e-6)
            rate = new


def test_a_hand_that_trembles_on_another_axis_does_not_end_it() -> None:
    """What falls there in a step has room in that step, beside what grows."""
    acceleration, ease = (2.0, 2.0, 2.0), Ease(0.1, 0.1)
    moving = limiter(Saturation.BOTH, (1.0, 1.0, 1.0), acceleration, (20.0, 20.0, 20.0))
    before = 0.0
    for step in range(500):
        trembling = 0.2 * acceleration[2] * PERIOD * (-1.0) ** step
        speed = moving.step((1.0, 0.0, trembling), PERIOD, ease=ease)[0][0]
        assert speed - before <= 1.01 * ease.acceleration * acceleration[0] * PERIOD
        before = speed


@settings(max_examples=50, deadline=None)
@given(vectors, vectors, jerks, shares, st.lists(st.tuples(st.floats(-1.0, 1.0), eases), min_size=1, max_size=5))
def test_what_speeds_up_keeps_to_the_larger_of_both_and_soon_to_the_new_one(
    velocity: Rates, acceleration: Rates, jerk: Rates, way: tuple[float, ...], drive: list[tuple[float, Ease]]
) -> None:
    """To and fro on a line: at most what it had when the limit was changed, and in the time of its fall the new one."""
    moving = limiter(Saturation.BOTH, velocity, acceleration, jerk)
    top = scaled_by((way[0] / 1.5, way[1] / 1.5, 0.0), velocity)
    falls = 1.0 / landing_slope(acceleration, jerk)  # s, from the whole acceleration to none
    used = 0.0
    for size, ease in drive:
        target = tuple(size * value for value in top)
        since = 0.0
        for _ in range(int(2.0 * falls / PERIOD) + 2):
            before = moving.rates
            left = tuple(goal - value for goal, value in zip(target, before, strict=True))
            faster = sum(b * w for b, w in zip(before, left, strict=True)) >= 0.0
            after, _ = moving.step(target, PERIOD, ease=ease)
            now = excess(between(before, after), acceleration)
            since = since + PERIOD if faster else 0.0
            assert not faster or now <= max(ease.acceleration, used) * (1 + 1e-6)
            assert since <= falls + 2 * PERIOD or now <= ease.acceleration * (1 + 1e-6)
            used = now


@settings(max_examples=50, deadline=None)
@given(kinds, vectors, vectors, jerks, stretches, eases)
def test_no_stop_is_weaker(  # noqa: PLR0917  # hypothesis gives them by place
    kind: Saturation,
    velocity: Rates,
    acceleration: Rates,
    jerk: Rates,
    drive: list[tuple[tuple[float, ...], Ease, int]],
    ease: Ease,
) -> None:
    """From any motion a zero command is driven as the robot file has it, number for number, whatever was set."""
    moving, untouched = (limiter(kind, velocity, acceleration, jerk) for _ in range(2))
    for share, set_before, cycles in drive:
        for one in (moving, untouched):
            for _ in range(cycles):
                one.step(scaled_by(share, velocity), PERIOD, ease=set_before)
    for _ in range(20_000):
        assert moving.step((0.0, 0.0, 0.0), PERIOD, ease=ease)[0] == untouched.step((0.0, 0.0, 0.0), PERIOD)[0]
        if moving.at_rest:
            return
    pytest.fail("never at rest")


ONE_AXIS = [(0.0, 0.8, 0.0), (0.0, -0.3, 0.5), (0.0, 0.0, 1.0), (0.2, 0.8, 0.0)]


@settings(max_examples=50, deadline=None)
@given(kinds, vectors, vectors, jerks, st.sampled_from(ONE_AXIS), eases)
def test_an_axis_that_is_to_fall_falls_as_without_any_whatever_grows_beside_it(  # noqa: PLR0917
    kind: Saturation, velocity: Rates, acceleration: Rates, jerk: Rates, share: tuple[float, ...], ease: Ease
) -> None:
    """From forward to sideways, to turning, to a slower curve: number for number, but for the last step of it."""
    moving, untouched = (limiter(kind, velocity, acceleration, jerk) for _ in range(2))
    for one in (moving, untouched):
        for _ in range(5_000):
            one.step(scaled_by((0.8, 0.0, 0.0), velocity), PERIOD)
    target = scaled_by(share, velocity)
    for _ in range(20_000):
        speed, slow = moving.step(target, PERIOD, ease=ease)[0][0], untouched.step(target, PERIOD)[0][0]
        assert abs(speed - slow) <= acceleration[0] * PERIOD * SAME
        if slow == untouched.rates[0] == target[0] and abs(speed - target[0]) < 1e-6:
            return
    pytest.fail("never there")


@settings(max_examples=50, deadline=None)
@given(vectors, vectors, jerks, shares, st.lists(st.tuples(st.floats(0.0, 1.0), eases), min_size=1, max_size=6))
def test_from_rest_it_arrives_and_never_goes_beyond(
    velocity: Rates,
    acceleration: Rates,
    jerk: Rates,
    share: tuple[float, ...],
    set_on_the_way: list[tuple[float, Ease]],
) -> None:
    """Wherever on the way it is set: also where a smaller jerk could not end in time what a larger one began."""
    moving = limiter(Saturation.BOTH, velocity, acceleration, jerk)
    target = (*[max(-1.0, min(1.0, one)) * top for one, top in zip(share[:2], velocity[:2], strict=True)], 0.0)
    size, ease = excess(target, velocity), NO_EASE
    plan = sorted(set_on_the_way)
    for _ in range(60_000):
        while plan and plan[0][0] * size <= excess(moving.rates, velocity):
            ease = plan.pop(0)[1]
        after, active = moving.step(target, PERIOD, ease=ease)
        for value, goal in zip(after, target, strict=True):
            assert abs(value) <= abs(goal) * SAME
            assert value * goal >= 0.0
        if after == target and "acceleration" not in active:
            return
    pytest.fail("never arrives")


def test_a_step_of_arrival_is_as_soft_as_the_others() -> None:
    """With a jerk by which all of it could be covered at once."""
    moving = limiter(Saturation.BOTH, (1.0, 1.0, 1.0), (0.5, 0.5, 0.5), (50.0, 50.0, 50.0))
    for _ in range(40):
        before = moving.rates
        after, _ = moving.step((0.0006, 0.0, 0.0), PERIOD, ease=Ease(0.05, 1.0))
        assert between(before, after)[0] <= 0.05 * 0.5 * SAME
    assert moving.rates == (0.0006, 0.0, 0.0)


def test_half_of_acceleration_and_a_tenth_of_jerk_take_the_time_that_physics_needs() -> None:
    """0 to 1 m/s at 0.5 m/s^2 with 0.5 m/s^3: v/a + a/j = 3 s. And back at the limits: 1 + 1/5 s."""
    moving = limiter(Saturation.BOTH, (2.0, 2.0, 2.0), (1.0, 1.0, 1.0), (5.0, 5.0, 5.0))
    seconds = []
    for target in ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)):
        cycles = 0
        while moving.rates != target:
            moving.step(target, PERIOD, ease=Ease(0.5, 0.1))
            cycles += 1
        seconds.append(cycles * PERIOD)
    assert seconds == pytest.approx([3.0, 1.2], abs=0.03)


def test_without_any_it_is_what_it_was() -> None:
    moving, same = (limiter(Saturation.BOTH, (2.0, 2.0, 2.0), (1.0, 1.0, 1.0), (5.0, 5.0, 5.0)) for _ in range(2))
    chance = Random(5)
    for _ in range(50):
        target = tuple(chance.uniform(-2.0, 2.0) for _ in range(3))
        for _ in range(40):
            assert moving.step(target, PERIOD) == same.step(target, PERIOD, ease=Ease(1.0, 1.0))
    assert Ease() == NO_EASE


def put(world: World, setting: str, value: float) -> None:
    request = Request(RequestKind.SET, 7, world.now_ns + world.period_ns, setting=setting, value=value)
    (reply,) = world.cycle(requests=[request]).replies
    assert reply.ok, reply.reason


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("setting", "value", "twist", "expected"),
    [
        ("linear_speed", 0.3, Twist(1.0, 1.0, 0.0), lambda speed, turn: (speed, turn) == pytest.approx((0.3, 0.0))),
        ("linear_speed", 0.3, Twist(0.6, 0.0, 0.4), lambda speed, turn: (speed, turn) == pytest.approx((0.3, 0.2))),
        ("angular_speed", 0.2, Twist(0.6, 0.0, 0.4), lambda speed, turn: (speed, turn) == pytest.approx((0.3, 0.2))),
        ("angular_speed", 0.2, Twist(0.6, 0.0, 0.0), lambda speed, turn: (speed, turn) == pytest.approx((0.6, 0.0))),
    ],
)
def test_speeds_of_translation_and_of_turning_are_held(
    name: str, setting: str, value: float, twist: Twist, expected: object
) -> None:
    """While it drives, in the direction that is asked for, and told by name."""
    world = World(name)
    world.start()
    world.run(3.0, twist)
    begin = len(world.records)
    put(world, setting, value)
    world.run(3.0, twist)
    vx, vy, wz = world.last.trace.setpoint
    assert callable(expected)
    assert expected(sqrt(vx * vx + vy * vy), abs(wz))
    limits = world.config.limits
    setpoints = [outputs.trace.setpoint for _, outputs in world.records[begin - 1 :]]
    for before, after in pairwise(setpoints):
        assert excess(between(before, after), limits.acceleration.as_twist()) <= 1 + 1e-6
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    assert (setting in status.limits_active) is (setpoints[0] != setpoints[-1])


@pytest.mark.parametrize("name", NAMES)
def test_the_robot_speeds_up_as_softly_as_it_is_set_and_stops_as_hard_as_ever(name: str) -> None:
    ways = []
    for share in (None, 0.25):
        world = World(name)
        world.start()
        if share is not None:
            put(world, "acceleration_override", share)
            put(world, "jerk_override", share)
        limit = world.config.limits.acceleration.vx * (share or 1.0)
        begin = len(world.records)
        world.run(5.0, Twist(0.8, 0.0, 0.0))
        speeds = [outputs.trace.setpoint.vx for _, outputs in world.records[begin:]]
        steps = [(after - before) / PERIOD for before, after in pairwise(speeds)]
        assert speeds[-1] == 0.8
        assert max(steps) == pytest.approx(limit, rel=1e-6)
        begin = len(world.records)
        world.run(2.0, Twist(0.0, 0.0, 0.0))
        ways.append([outputs.trace.setpoint.vx for _, outputs in world.records[begin:]])
    assert ways[0] == ways[1]
    assert ways[0][-1] == 0.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", ["silence", "estop", "power_off"])
def test_every_end_of_a_drive_is_that_of_the_robot_file(name: str, end: str) -> None:
    """Silence, an emergency stop and a lost motor, in a robot that was set as soft as can be: number for number."""
    drives = []
    for soft in (False, True):
        world = World(name)
        world.start()
        world.run(2.0, Twist(0.8, 0.0, 0.3))
        for setting in ("acceleration_override", "jerk_override"):
            put(world, setting, 0.05 if soft else 1.0)
        begin = len(world.records)
        if end == "estop":
            world.request(RequestKind.ESTOP)
        if end == "power_off":
            world.bus.robot.devices[world.config.robot.motor_names()[0]].power_off()
        world.run(4.0)
        assert world.last.mode in {Mode.IDLE, Mode.ESTOP, Mode.FAULT}
        drives.append([(outputs.trace.setpoint, outputs.frames) for _, outputs in world.records[begin:]])
    assert drives[0] == drives[1]


@pytest.mark.parametrize("name", NAMES)
def test_it_is_recorded_with_the_core(name: str) -> None:
    """A core that is built from a snapshot on the way goes on with what was set, byte for byte."""
    world = World(name)
    world.start()
    for setting, value in (
        *(("linear_speed", 0.5), ("angular_speed", 0.3)),
        *(("acceleration_override", 0.3), ("jerk_override", 0.2)),
    ):
        put(world, setting, value)
        world.run(0.3, Twist(0.8, 0.1, 0.5))
    assert goes_on_byte_for_byte(world.records, world.config, every=7) > 30
