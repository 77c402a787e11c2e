"""Pull-region analysis and compensation against the figures of science 1.3, 1.4 and section 6, M2 to M9."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.control.compensation import (
    WHOLE_CIRCLE,
    Compensation,
    PathRate,
    RegionAt,
    largest_region,
    longest_period,
    region_at,
    region_refusal,
)
from gateway.control.pull_region import Pull, Region, examine, flip_speeds, flip_way, goal_of, settled, turn_radius
from gateway.types import Region as WayRound

D1, C = 0.25, 1.2  # m, m/s
EVERYWHERE = (RegionAt(0.0, math.pi),)


def advance(gamma: float, way: float, d1: float = D1) -> float:
    """The chassis after a straight way at a constant direction: tan(g/2) falls e-fold every d1 (science 1.3)."""
    return 2.0 * math.atan(math.tan(gamma / 2.0) * math.exp(-way / d1))


def drive(
    error: float,
    seconds: float,
    h: float,
    *,
    gain: float,
    region: float = math.pi,
    c: float = C,
    authority: float = 1e9,
) -> list[float]:
    """Errors of a straight drive along x, cycle by cycle: the chassis at heading 0, the platform's is gamma."""
    compensation = Compensation(gain=gain, regions=EVERYWHERE, axle_offset=D1, authority=1e9)
    heading, errors = math.pi - error, []  # of the chassis against the direction of motion, negated
    for _ in range(round(seconds / h)):
        # The platform looks along x and moves along x; the joint angle is minus the chassis heading.
        vx, vy, pull = compensation.turn(C, 0.0, joint=heading, path_rate=0.0, dt=h)
        assert math.hypot(vx, vy) == pytest.approx(C, rel=1e-12)
        assert pull is not None
        gamma = heading + math.atan2(vy, vx)  # of the velocity that is driven
        before = gamma
        heading += advance(math.remainder(gamma, math.tau), C * h) - math.remainder(before, math.tau)
        errors.append(math.remainder(heading - math.pi, math.tau))
    return errors


def seen(speed: float, *, angle: float) -> Pull:
    pull = examine(speed, 0.0, angle=angle, path_rate=0.0, axle_offset=D1)
    assert pull is not None
    return pull


def way_of(pull: Pull) -> float | None:
    return flip_way(pull.gamma, pull.error, speed=pull.speed, path_rate=pull.path_rate, axle_offset=D1)


def test_where_the_chassis_is_by_hand() -> None:
    """Platform and chassis at heading 0 and moving forward: pushed. Moving backward: pulled. Sideways: neutral."""
    pushed = examine(1.0, 0.0, angle=0.0, path_rate=0.0, axle_offset=D1)
    pulled = examine(-1.0, 0.0, angle=0.0, path_rate=0.0, axle_offset=D1)
    across = examine(0.0, 1.0, angle=0.0, path_rate=0.0, axle_offset=D1)
    assert pushed is not None
    assert pulled is not None
    assert across is not None
    assert (pushed.region, pushed.gamma) == (Region.PUSH, 0.0)
    assert pulled.region is Region.PULL
    assert (pulled.gamma, pulled.error) == pytest.approx((math.pi, 0.0))
    assert across.region is Region.NEUTRAL
    assert across.gamma == pytest.approx(math.pi / 2)
    assert turn_radius(pulled.speed, pulled.path_rate) is None
    turned = examine(0.0, 1.0, angle=math.pi / 2, path_rate=0.5, axle_offset=D1)  # chassis looks to -y, moves to +y
    assert turned is not None
    assert (turned.region, turn_radius(turned.speed, turned.path_rate)) == (Region.PULL, 2.0)
    assert turn_radius(1e300, 1e-300) is None  # as good as straight on


@pytest.mark.parametrize("speed", [0.0, 0.5e-3, 0.999e-3])
def test_at_rest_there_is_no_direction(speed: float) -> None:
    assert examine(speed, 0.0, angle=1.0, path_rate=0.0, axle_offset=D1) is None


def test_goal_on_a_turning_path_m9() -> None:
    """R = 0.2 m, d1 = 0.145: 133.531 degrees; R = d1: 90; tighter: clamped, and said."""
    for radius, degrees, saturated in ((0.2, 133.531, False), (0.145, 90.0, False), (0.1, 90.0, True)):
        goal, clamped = goal_of(1.0 / radius, 1.0, 0.145)
        assert math.degrees(goal) == pytest.approx(degrees, abs=5e-4)
        assert clamped is saturated
    assert goal_of(-1.0 / 0.2, 1.0, 0.145)[0] == pytest.approx(math.tau - goal_of(1.0 / 0.2, 1.0, 0.145)[0])


def test_the_way_until_it_flips() -> None:
    """0.576 m per decade of the error at d1 = 0.25 (science 1.3), and what is predicted is what then happens."""
    for decade in (1e-2, 1e-3, 1e-4):
        one, ten = seen(C, angle=math.pi - decade), seen(C, angle=math.pi - 10.0 * decade)
        way = way_of(one)
        assert way is not None
        assert way - (way_of(ten) or 0.0) == pytest.approx(0.576, abs=1.5e-3)
        assert abs(advance(one.gamma, way)) == pytest.approx(math.pi / 2, abs=1e-9)
    assert way_of(seen(C, angle=0.1)) is None  # pushed


@settings(max_examples=80, deadline=None)
@given(st.floats(-1.5, 1.5).filter(lambda e: abs(e) > 1e-3), st.floats(-2.0, 2.0))
def test_the_way_until_it_flips_on_a_path_that_turns(off_pull: float, sigma: float) -> None:
    """`sigma`: d1 over the radius. Integrated: d gamma/ds = (sigma - sin gamma)/d1 until cos gamma = 0."""
    gamma = math.pi + off_pull
    pull = examine(math.cos(gamma), math.sin(gamma), angle=0.0, path_rate=sigma / D1, axle_offset=D1)
    assert pull is not None
    predicted = way_of(pull)
    if abs(sigma) < 1.0 and abs(pull.error) < 1e-3:
        return  # longer than it is worth to integrate
    assert predicted is not None
    h, way = 1e-3, 0.0
    while math.cos(gamma) < 0.0:
        half = gamma + 0.5 * h * (sigma - math.sin(gamma))
        before, gamma, way = gamma, gamma + h * (sigma - math.sin(half)), way + h
        assert way < 2e3
    way -= h * math.cos(gamma) / (math.cos(gamma) - math.cos(before))
    assert predicted == pytest.approx(way * D1, rel=2e-3, abs=2e-3 * D1)


@pytest.mark.parametrize("sigma", [0.0, 0.3, -0.9, 0.9999999, 1.0, -1.0, 1.0000001, 3.0])
@pytest.mark.parametrize("ulps", range(-4, 5))
def test_in_balance_and_next_to_it_no_flip_is_a_number_that_is_none(sigma: float, ulps: int) -> None:
    goal = math.pi - math.asin(max(-1.0, min(1.0, sigma)))
    gamma = goal + ulps * 4.5e-16
    pull = examine(math.cos(gamma), math.sin(gamma), angle=0.0, path_rate=sigma / D1, axle_offset=D1)
    assert pull is not None
    way = way_of(pull)
    assert way is None or 0.0 <= way < 5e4 * D1


def test_noise_about_neutral_steering_toggles_nothing() -> None:
    told: list[Region | None] = [None]
    for degrees in (80.0, 89.9, 90.1, 89.5, 92.0, 88.0, 93.5, 90.0, 89.0, 91.0, 88.0, 86.0, 95.0):
        gamma = math.radians(degrees)
        pull = examine(math.cos(gamma), math.sin(gamma), angle=0.0, path_rate=0.0, axle_offset=D1)
        told.append(settled(told[-1], pull))
    assert [region.name if region else None for region in told[1:]] == [*["PUSH"] * 6, *["PULL"] * 5, "PUSH", "PULL"]
    assert settled(Region.PULL, None) is None


def test_speeds_of_a_flip_are_the_extremes_over_gamma() -> None:
    """Otbot at 1.2 m/s: by a search over gamma in the equations of science 1.1."""
    wheel, joint = flip_speeds(C, wheel_radius=0.1, axle_offset=D1, track=0.4)
    gammas = [k * math.pi / 5000 for k in range(5001)]
    assert wheel == pytest.approx(
        max(abs(C * math.cos(g) - C / D1 * math.sin(g) * 0.2) / 0.1 for g in gammas), rel=1e-6
    )
    assert joint == pytest.approx(max(abs(C / D1 * math.sin(g)) for g in gammas), rel=1e-6)


@pytest.mark.parametrize(
    ("gain", "figures"),
    [
        (0.0, {0.1: 31.81, 0.2: 49.45, 0.5: 125.55, 1.0: 174.66}),  # M3
        (1.0, {0.1: 20.0, 0.5: 20.0, 1.0: 20.0}),  # M4
        (2.0, {0.1: 12.426, 0.2: 7.690, 0.5: 1.812, 1.0: 0.163}),  # M5, at 1 kHz
    ],
)
def test_drives_from_20_degrees_m3_m4_m5(gain: float, figures: dict[float, float]) -> None:
    errors = drive(math.radians(20.0), 1.0, 1e-3, gain=gain)
    for seconds, degrees in figures.items():
        assert abs(math.degrees(errors[round(seconds * 1000) - 1])) == pytest.approx(degrees, abs=0.01)


def test_gain_two_is_the_mirror_image_m6() -> None:
    """Eq. 23: v mirrored at the axis of the goal."""
    for degrees in (-80.0, -10.0, 3.0, 60.0):
        error = math.radians(degrees)
        compensation = Compensation(gain=2.0, regions=EVERYWHERE, axle_offset=D1, authority=1e9)
        vx, vy, pull = compensation.turn(C, 0.0, joint=math.pi + error, path_rate=0.0, dt=1e-3)
        assert pull is not None
        assert pull.error == pytest.approx(error, abs=1e-12)
        axis = pull.goal - (math.pi + error)  # the chassis' heading is minus the joint's angle; the velocity was at 0
        assert math.remainder(math.atan2(vy, vx) - 2.0 * axis, math.tau) == pytest.approx(0.0, abs=1e-12)


def test_nothing_is_corrected_beyond_the_region_m7() -> None:
    compensation = Compensation(gain=2.0, regions=(RegionAt(0.0, 0.5),), axle_offset=D1, authority=1e9)
    assert compensation.turn(C, 0.0, joint=math.pi + 0.51, path_rate=0.0, dt=1e-3)[:2] == (C, 0.0)
    assert compensation.turn(C, 0.0, joint=math.pi + 0.49, path_rate=0.0, dt=1e-3)[1] != 0.0
    assert largest_region(3.0) == pytest.approx(math.radians(45.0))  # 60 degrees are refused
    assert largest_region(2.0) == pytest.approx(math.radians(90.0))
    assert largest_region(4.0) == pytest.approx(math.radians(30.0))
    assert largest_region(1.0) == WHOLE_CIRCLE >= math.pi
    for gain in (1.0, 1.7, 2.0, 2.34, 3.0, 4.0):  # what the refusal tells is taken
        told = float(f"{largest_region(gain):.4g}")
        assert region_refusal(gain, told) is None
        assert f"allowed up to {told:g} rad" in str(region_refusal(gain, told * 1.002))


def test_the_limit_of_a_sampled_loop_m8() -> None:
    """a = c h/d1: 1.0 settles, 1.12 does not; 1.0986 d1/c is the limit for k = 2. A small error, over 200 periods."""
    assert longest_period(2.0, axle_offset=D1, speed=C) == pytest.approx(1.0986 * D1 / C, rel=1e-4)
    assert longest_period(1.0, axle_offset=D1, speed=C) == math.inf
    for a, settles in ((1.0, True), (1.09, True), (1.11, False), (1.12, False)):
        h = a * D1 / C
        errors = drive(1e-3, 200 * h, h, gain=2.0)
        assert (abs(errors[-1]) < 1e-3) is settles


@settings(max_examples=100, deadline=None)
@given(st.floats(1.05, 4.0), st.floats(0.02, 1.0))
def test_what_the_limit_says_is_what_the_loop_does(gain: float, share: float) -> None:
    h = longest_period(gain, axle_offset=D1, speed=C)
    inside, beyond = drive(1e-4, 50 * h * share, h * share, gain=gain), drive(1e-4, 60 * h, h * 1.02, gain=gain)
    assert abs(inside[-1]) <= 1e-4 * (1.0 + 1e-6)
    assert max(map(abs, beyond)) > 1e-4


def test_a_table_of_regions() -> None:
    table = (RegionAt(0.5, 1.0), RegionAt(1.0, 0.5), RegionAt(1.5, 0.5))
    assert [region_at(table, speed) for speed in (0.0, 0.5, 0.75, 1.0, 1.2, 9.0)] == [1.0, 1.0, 0.75, 0.5, 0.5, 0.5]
    assert region_at((RegionAt(0.0, 0.7),), 0.3) == 0.7


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-7.0, 7.0), st.floats(0.0, 4.0)), max_size=40
    )
)
def test_whatever_changes_the_velocity_turns_without_a_step(steps: list[tuple[float, float, float, float]]) -> None:
    """Direction, joint angle and gain at random: the correction turns by the authority at most, and keeps the speed."""
    compensation = Compensation(gain=2.0, regions=(RegionAt(0.0, 1.5),), axle_offset=D1, authority=3.0)
    before = 0.0
    for vx, vy, joint, gain in steps:
        compensation.gain = gain
        x, y, pull = compensation.turn(vx, vy, joint=joint, path_rate=0.0, dt=0.004)
        speed = math.hypot(vx, vy)
        assert math.hypot(x, y) == pytest.approx(speed, rel=1e-12, abs=1e-300)
        if pull is None:
            assert (x, y, compensation.angle) == (vx, vy, 0.0)
        else:
            assert speed * abs(compensation.angle - before) <= 3.0 * 0.004 * (1.0 + 1e-9)
        before = compensation.angle


def test_an_angle_that_is_not_known_corrects_nothing() -> None:
    compensation = Compensation(gain=2.0, regions=EVERYWHERE, axle_offset=D1, authority=1e9)
    assert compensation.turn(C, 0.1, joint=None, path_rate=0.0, dt=0.004) == (C, 0.1, None)


def test_the_rate_of_a_path_from_its_motion() -> None:
    """A circle in the world: body rate for one who turns along, the direction's own for one who keeps his heading."""
    for wz, turning in ((0.5, 0.0), (0.0, 0.5), (0.5, -0.5), (-0.2, 0.7)):
        rate, told = PathRate(), 0.0
        for cycle in range(500):
            angle = turning * cycle * 0.004
            told = rate.of(math.cos(angle), math.sin(angle), wz, 0.004)
        assert told == pytest.approx(wz + turning, abs=1e-4)


def test_turning_back_and_standing_are_no_rate() -> None:
    rate = PathRate()
    rate.of(1.0, 0.0, 0.0, 0.004)
    assert rate.of(-1.0, 0.0, 0.0, 0.004) == 0.0
    assert rate.of(0.0, 0.0, 0.3, 0.004) == 0.3
    assert rate.of(0.0, 1.0, 0.3, 0.004) == 0.3


def settles(gain: float, period: float, delay: float) -> bool:
    """Of de/dt = e - k e_measured, time in units of d1/c: the correction held for a period, its measurement late.

    Many small steps of the equation itself, from an error of 1: no formula of the limit in it.
    """
    parts = 40  # of a period
    errors, held, late = [1.0], 0.0, round(delay / period * parts)
    growth = math.exp(period / parts)
    for cycle in range(max(300, round(100.0 / period))):
        now = cycle * parts
        held = gain * errors[now - late] if now >= late else 0.0
        for _ in range(parts):
            errors.append(growth * errors[-1] - held * (growth - 1.0))
        if abs(errors[-1]) > 1e6:
            return False
    quarter = len(errors) // 4
    return max(map(abs, errors[-quarter:])) < max(map(abs, errors[quarter : 2 * quarter]))


@pytest.mark.parametrize("gain", [1.5, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.35, 0.5, 0.75, 0.9])
def test_the_limit_with_an_old_angle(gain: float, share: float) -> None:
    """`share`: of the delay with which no period is short enough; below the limit every delay up to it settles.

    A delay of a small part of the period helps, which is not relied upon.
    """
    delay = share * math.acos(1.0 / gain) / math.sqrt(gain * gain - 1.0)
    limit = longest_period(gain, axle_offset=D1, speed=C, delay=delay * D1 / C) * C / D1
    assert all(settles(gain, 0.95 * limit, part * delay) for part in (0.0, 0.3, 0.6, 1.0))
    assert not all(settles(gain, 1.15 * limit + 0.01, part * delay) for part in (0.0, 1.0))


def test_the_limit_with_an_old_angle_by_hand() -> None:
    """k = 2: one whole cycle late ln 1.5 (Jury: 2(e^h - 1) < 1); pi/3/sqrt 3 late, no period is short enough."""
    one = 0.4054651081081644
    for delay, limit in ((one * 0.999999, one), (0.61, 0.0)):
        got = longest_period(2.0, axle_offset=D1, speed=C, delay=delay * D1 / C)
        assert got * C / D1 == pytest.approx(limit, rel=1e-5)


@pytest.mark.parametrize(
    ("asked", "region", "corrects"),
    [
        (WayRound.ANY, 1.57, False),
        (WayRound.PULL, 1.57, True),
        (WayRound.PUSH, 1.57, False),
        (WayRound.ANY, 1.6, True),  # a region with errors beyond neutral steering in it, on purpose
        (WayRound.PUSH, 1.6, False),
    ],
)
def test_pushed_round_a_bend_only_who_asks_to_be_pulled_is_corrected(
    asked: WayRound, region: float, *, corrects: bool
) -> None:
    """d1 over the radius 0.8: pushed it lies at asin 0.8 = 0.927 rad, 1.287 rad off the balance of pull at 2.214."""
    one = Compensation(gain=2.0, regions=(RegionAt(0.0, region),), axle_offset=D1, authority=1e9)
    *_, pull = one.turn(C, 0.0, joint=0.927, path_rate=0.8 * C / D1, dt=1e-3, asked=asked)
    assert pull is not None
    assert pull.error == pytest.approx(-1.287, abs=1e-3)
    assert (one.angle != 0.0) is corrects


def test_what_is_corrected_stays_so_across_neutral_steering_and_not_for_who_asks_to_be_pushed() -> None:
    one = Compensation(gain=2.0, regions=(RegionAt(0.0, 1.57),), axle_offset=D1, authority=1e9)

    def angle(joint: float, asked: WayRound = WayRound.ANY) -> float:
        one.turn(C, 0.0, joint=joint, path_rate=0.8 * C / D1, dt=1e-3, asked=asked)
        return one.angle

    assert angle(1.5) == 0.0  # pushed
    assert angle(1.6) != 0.0
    assert angle(1.5) != 0.0
    assert angle(1.5, WayRound.PUSH) == 0.0
    assert angle(1.5) == 0.0
