"""Translation and rotation with profiles of their own, and which of them is kept: by figures, by laws, by drives."""

from itertools import pairwise
from math import hypot

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.config import ConfigError, parse
from gateway.control.decoupled import Decoupled, Saturation
from gateway.control.limits import TwistLimiter, excess, turning_excess
from gateway.control.wheel_limits import WheelLimits
from gateway.kinematics.contract import desaturate
from gateway.kinematics.linear import Matrix
from gateway.types import ZERO_TWIST, Mode, Outputs, Rates, Twist
from tests.omni_layouts import LAYOUTS, text
from tests.world import World, robot_text

BOTH, TRANSLATION, ROTATION = Saturation.BOTH, Saturation.TRANSLATION, Saturation.ROTATION
# The plus layout with wheels of 1 m radius at 1 m: two roll forward, two to the left.
PLUS: Matrix = ((1.0, 0.0, -1.0), (1.0, 0.0, 1.0), (0.0, 1.0, -1.0), (0.0, 1.0, 1.0))
WIDE, HARD = Twist(10, 10, 10), Twist(500, 500, 500)
LAYOUT_ROWS = {name: parse(text(name), name).robot.kinematics().matrix() for name in LAYOUTS}


def limiter(
    saturation: Saturation,
    *,
    acceleration: Rates = (1.0, 1.0, 4.0),
    jerk: Rates = HARD,
    velocity: Rates = WIDE,
    rows: Matrix = PLUS,
    speed: float = 100.0,
    change: float | None = None,
) -> TwistLimiter:
    accelerations = () if change is None else (change,) * len(rows)
    wheels = WheelLimits(rows, speeds=(speed,) * len(rows), accelerations=accelerations)
    course = None
    if saturation is not BOTH:
        course = Decoupled(saturation, velocity=velocity, acceleration=acceleration, jerk=jerk, wheels=wheels)
    return TwistLimiter(
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        wheels=None if change is None else wheels,
        course=course,
    )


def settle(moving: TwistLimiter, target: Twist, dt: float = 0.01) -> tuple[Rates, tuple[str, ...]]:
    """The setpoint after a minute, and the limits that hold it there."""
    for _ in range(6000):
        moving.step(target, dt)
    return moving.rates, moving.step(target, dt)[1]


# Wheels of up to 2 rad/s: forward 1.5 m/s and 1 rad/s ask 2.5 of one, 2.5 m/s and 3 rad/s are too much by themselves.
CUTS = {
    "rotation gets the rest": (TRANSLATION, (1.5, 0, 1), (1.5, 0, 0.5), ("motor_speed", "rotation_cut")),
    "the other way round": (TRANSLATION, (-1.5, 0, -1), (-1.5, 0, -0.5), ("motor_speed", "rotation_cut")),
    "translation gets the rest": (ROTATION, (1.5, 0, 1), (1, 0, 1), ("motor_speed", "translation_cut")),
    "in its direction": (ROTATION, (1.5, -0.6, 1), (1, -0.4, 1), ("motor_speed", "translation_cut")),
    "nothing is left": (TRANSLATION, (2.5, 0, 1), (2, 0, 0), ("motor_speed", "translation_cut", "rotation_cut")),
    "nor here": (ROTATION, (1, 1, 3), (0, 0, 2), ("motor_speed", "rotation_cut", "translation_cut")),
    "enough for both": (TRANSLATION, (1, 0, 1), (1, 0, 1), ()),
}


@pytest.mark.parametrize(("first", "target", "goal", "names"), CUTS.values(), ids=CUTS)
def test_top_speed_of_wheels(first: Saturation, target: Rates, goal: Rates, names: tuple[str, ...]) -> None:
    moving = limiter(first, acceleration=(10.0, 10.0, 10.0), speed=2.0)
    reached, active = settle(moving, Twist(*target))
    assert reached == pytest.approx(goal, abs=1e-9)
    assert active == names


# w x v may take 0.7 of 1 m/s^2.
TURNS = {
    "slower turn": (TRANSLATION, (1, 0, 1), (1, 0, 0.7), ("turning", "rotation_cut")),
    "slower": (ROTATION, (1, 0, 1), (0.7, 0, 1), ("turning", "translation_cut")),
    "slower in its direction": (ROTATION, (2, -1, 1), (0.7, -0.35, 1), ("turning", "translation_cut")),
    "too fast alone, and too much": (TRANSLATION, (20, 0, 1), (10, 0, 0.07), ("velocity", "turning", "rotation_cut")),
}


@pytest.mark.parametrize(("first", "target", "goal", "names"), TURNS.values(), ids=TURNS)
def test_turning_of_the_body(first: Saturation, target: Rates, goal: Rates, names: tuple[str, ...]) -> None:
    reached, active = settle(limiter(first), Twist(*target))
    assert reached == pytest.approx(goal, abs=1e-9)
    assert active == names


def test_limits_of_one_do_not_slow_down_the_other() -> None:
    """Twice its top speed along x: so much for the translation; the turn of half its top speed stays."""
    moving = limiter(TRANSLATION, velocity=(1.0, 1.0, 0.4))
    reached, active = settle(moving, Twist(2, 1, 0.2))
    assert reached == pytest.approx((1, 0.5, 0.2), abs=1e-9)
    assert active == ("velocity",)
    moving = limiter(ROTATION, velocity=(1.0, 1.0, 0.4))
    reached, active = settle(moving, Twist(0.5, 0, 0.8))
    assert reached == pytest.approx((0.5, 0, 0.4), abs=1e-9)
    assert active == ("velocity",)


@pytest.mark.parametrize("first", [TRANSLATION, ROTATION])
def test_whichever_is_there_first_does_not_wait(first: Saturation) -> None:
    """1 m/s at 1 m/s^2 takes 1 s, 0.5 rad/s at 4 rad/s^2 an eighth of it; together, as long as the slower one."""
    apart, together = limiter(first), limiter(BOTH)
    for _ in range(25):
        apart.step(Twist(1, 0, 0.5), 0.01)
        together.step(Twist(1, 0, 0.5), 0.01)
    assert apart.rates == pytest.approx((0.25, 0.0, 0.5), abs=0.01)
    assert together.rates == pytest.approx((0.25, 0.0, 0.125), abs=0.01)
    alone = limiter(first)
    ways = [[moving.step(Twist(1, 0, wz), 0.01)[0][0] for _ in range(120)] for moving, wz in ((alone, 0), (apart, 0.5))]
    assert ways[1][:95] == pytest.approx([min(1.0, 0.25 + way) for way in ways[0][:95]], abs=0.011)


# Wheels that change by 2 rad/s^2; the body by 1.5 m/s^2 and 4 rad/s^2, if they let it.
CHANGES = {
    TRANSLATION: (0.15, 0.05),  # 1.5 of 2 are the translation's, 0.5 are left
    ROTATION: (0.0, 0.2),  # all of them turn it
    BOTH: (0.1, 0.1),  # in proportion: (1, 1) asks 2 of a wheel
}


@pytest.mark.parametrize("saturation", CHANGES)
def test_acceleration_of_wheels(saturation: Saturation) -> None:
    moving = limiter(saturation, acceleration=(1.5, 1.5, 4.0), change=2.0)
    for _ in range(20):
        moving.step(Twist(5, 0, 5), 0.005)
    assert (moving.rates[0], moving.rates[2]) == pytest.approx(CHANGES[saturation], abs=0.01)


@pytest.mark.parametrize("saturation", Saturation)
def test_the_last_step_too_is_one_that_the_wheels_can_make(saturation: Saturation) -> None:
    """5 m/s^2 are within the limits of the body, and 0.05 m/s would be there in one step of 10 ms."""
    moving = limiter(saturation, acceleration=(10.0, 10.0, 10.0), change=2.0)
    assert moving.step(Twist(0.05, 0, 0), 0.01)[0] == pytest.approx((0.02, 0, 0))


@pytest.mark.parametrize("first", [TRANSLATION, ROTATION])
def test_what_turning_takes_of_the_floor_the_translation_does_not_get(first: Saturation) -> None:
    """At 1 m/s and 1 rad/s w x v takes 1 m/s^2 of 4 along y: 3 are left outwards, 4 inwards."""
    for vy, after in ((1, 0.3), (-1, -0.4)):
        moving = limiter(first, acceleration=(2.0, 4.0, 8.0))
        moving.reset((1.0, 0.0, 1.0))
        assert moving.step(Twist(1, vy, 1), 0.1)[0] == pytest.approx((1.0, after, 1.0))


class Floor:
    """It gives each group another share of its limits, and all twists the same share for turning."""

    def __init__(self, *, translation: float, rotation: float, turning: float = 0.0) -> None:
        self._shares, self._turning = (translation, rotation), turning
        self.beside: list[Rates] = []

    def turning(self, rates: Rates) -> float:
        return self._turning * rates[2]

    def effort(self, rates: Rates, way: Rates, beside: Rates) -> float:
        self.beside.append(beside)
        return self._shares[way[2] != 0.0]


@pytest.mark.parametrize(("translation", "rotation"), [(1.0, 0.25), (0.5, 1.0), (1.0, 1.0)])
def test_each_group_gets_of_the_floor_what_is_left_beside_the_other(translation: float, rotation: float) -> None:
    """The second beside what the first takes now, the first beside what the second cannot drop in this step."""
    moving, floor = limiter(TRANSLATION, jerk=(50, 50, 200)), Floor(translation=translation, rotation=rotation)
    before, rate = moving.rates, (0.0, 0.0, 0.0)
    active: tuple[str, ...] = ()
    for _ in range(12):  # before w x v is too much
        floor.beside.clear()
        now, active = moving.step(Twist(1, 0, 4), 0.01, ground=floor)
        gained = [(b - a) / 0.01 for a, b in zip(before, now, strict=True)]
        assert floor.beside[0] == pytest.approx((0.0, 0.0, max(0.0, rate[2] - 2.0)))
        assert floor.beside[1] == pytest.approx((gained[0], 0.0, 0.0))
        before, rate = now, (gained[0], gained[1], gained[2])
    assert rate == pytest.approx((translation, 0.0, 4.0 * rotation))
    assert ("grip" in active) is (min(translation, rotation) < 1.0)


def test_the_floor_too_cuts_the_second_where_both_turn_too_fast() -> None:
    moving = limiter(TRANSLATION, velocity=(0.1, 10, 10))
    floor = Floor(translation=1.0, rotation=1.0, turning=0.5)  # up to 2 rad/s
    for _ in range(3000):
        rates, active = moving.step(Twist(0.1, 0, 4), 0.01, ground=floor)
    assert rates == pytest.approx((0.1, 0.0, 2.0))
    assert {"turning", "rotation_cut"} <= set(active)


@pytest.mark.parametrize(
    ("first", "start", "target"),
    [
        (TRANSLATION, (0.2, 0, 3.5), (1, 0, 3.5)),
        (ROTATION, (3.5, 0, 0.2), (3.5, 0, 1)),
        (ROTATION, (3, 1, 0.2), (3, 1, -1)),
    ],
)
def test_the_first_waits_until_the_second_is_down(first: Saturation, start: Rates, target: Rates) -> None:
    """w x v keeps to 0.7 m/s^2 of the floor on every step, though the first could be there much sooner."""
    slow = (1.0, 1.0, 0.2) if first is TRANSLATION else (1.0, 1.0, 4.0)
    moving = limiter(first, acceleration=slow)
    moving.reset(start)
    most = 0.0
    for _ in range(3000):
        vx, vy, wz = moving.step(target, 0.01)[0]
        most = max(most, abs(wz) * max(abs(vx), abs(vy)))
    assert most == pytest.approx(0.7, rel=0.01)
    goal = (1.0, 0.0, 0.7) if first is TRANSLATION else (0.7, 0.7 * start[1] / start[0], target[2])
    assert moving.rates == pytest.approx(goal, abs=1e-9)


def test_rotation_goes_on_with_all_wheels_once_translation_is_there() -> None:
    """0.5 rad/s^2 for the third of a second in which 0.5 m/s are reached, then 2 rad/s^2."""
    moving = limiter(TRANSLATION, acceleration=(1.5, 1.5, 4.0), change=2.0)
    turns = [moving.step(Twist(0.5, 0, 1.2), 0.005)[0][2] for _ in range(100)]
    assert turns[59] == pytest.approx(0.15, abs=0.02)
    assert (turns[99] - turns[79]) / 0.1 == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("saturation", Saturation)
def test_brakes_along_the_whole_twist_within_what_the_wheels_can_change(saturation: Saturation) -> None:
    moving = limiter(saturation, acceleration=(1.5, 1.5, 4.0), change=2.0)
    moving.reset((1.0, 0.0, 0.5))  # 1.5 of a wheel: 0.75 s
    steps = [moving.rates]
    while not moving.at_rest:
        steps.append(moving.brake(0.005))
        assert len(steps) < 170
    assert len(steps) > 145
    for before, after in pairwise(steps):
        assert after[2] == pytest.approx(0.5 * after[0])
        assert (before[0] - after[0]) + (before[2] - after[2]) <= 2.0 * 0.005 * (1 + 1e-9)


limits = st.tuples(*[st.floats(0.5, 5.0)] * 3)
jerks = st.tuples(*[st.floats(5.0, 50.0)] * 3)
targets = st.lists(st.tuples(*[st.floats(-3.0, 3.0)] * 3), min_size=1, max_size=4)


@settings(max_examples=60, deadline=None)
@example(
    TRANSLATION,
    "symmetric",
    ((1.0, 0.5, 1.0), (1.0,) * 3, (5.0,) * 3),
    (15.0, 10.0),
    [(1.5, -0.75, 0.0), (0.0, -1.0, 1.0)],
    0.01,
)
@given(
    st.sampled_from(list(Saturation)),
    st.sampled_from(list(LAYOUTS)),
    st.tuples(limits, limits, jerks),
    st.tuples(st.floats(5.0, 40.0), st.one_of(st.none(), st.floats(5.0, 60.0))),
    targets,
    st.sampled_from([0.002, 0.004, 0.01]),
)
def test_every_limit_holds_on_every_step(  # noqa: PLR0917 - by hypothesis
    saturation: Saturation,
    layout: str,
    of_body: tuple[Rates, Rates, Rates],
    of_wheels: tuple[float, float | None],
    chosen: list[Rates],
    dt: float,
) -> None:
    """Body, floor and wheels, with the law's last cut, which holds the setpoint back as the engine does it.

    That cut is a step of its own: it shortens what goes past an aim that has jumped. Of the whole twist it is the rule
    where wheels saturate, so its accelerations are not bounded here.
    """
    (velocity, acceleration, jerk), (speed, change) = of_body, of_wheels
    rows = LAYOUT_ROWS[layout]
    moving = limiter(
        saturation, velocity=velocity, acceleration=acceleration, jerk=jerk, rows=rows, speed=speed, change=change
    )
    wheels = WheelLimits(rows, speeds=())
    before, slack = moving.rates, 1e-6
    for target in chosen:
        for _ in range(150):
            moving.step(target, dt)
            share = desaturate(wheels.use(moving.rates), (speed,) * len(rows))
            if share < 1.0:
                moving.scale(share)
                slack = 0.2
            now = moving.rates
            rate = [(new - old) / dt for new, old in zip(now, before, strict=True)]
            assert excess(now, velocity) <= 1 + 1e-9
            assert max(wheels.use(now)) <= speed * (1 + 1e-9)
            assert turning_excess(now, acceleration) <= 1.2
            if slack < 0.1 or saturation is not BOTH:
                assert excess(tuple(rate), acceleration) <= 1 + slack
                assert change is None or max(wheels.use(tuple(rate))) <= change * (1 + slack) + 1e-6
            before = now


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([TRANSLATION, ROTATION]),
    st.sampled_from(list(LAYOUTS)),
    st.tuples(st.floats(5.0, 40.0), st.one_of(st.none(), st.floats(5.0, 60.0))),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
def test_the_direction_of_the_translation_is_kept_and_the_first_gets_all_it_can_have(
    first: Saturation, layout: str, of_wheels: tuple[float, float | None], target: Rates
) -> None:
    speed, change = of_wheels
    rows, acceleration = LAYOUT_ROWS[layout], (2.0, 1.5, 6.0)
    moving = limiter(
        first,
        velocity=(2.0, 1.5, 4.0),
        acceleration=acceleration,
        jerk=(15.0, 12.0, 40.0),
        rows=rows,
        speed=speed,
        change=change,
    )
    wheels = WheelLimits(rows, speeds=())
    for _ in range(4000):
        (vx, vy, wz), active = moving.step(target, 0.01)
        assert vx * target[1] - vy * target[0] == pytest.approx(0.0, abs=1e-9), "from rest along its direction"
        assert vx * target[0] >= -1e-12
        assert wz * target[2] >= -1e-12
        if "acceleration" not in active:
            break
    else:
        pytest.fail("never arrives")
    translation, rotation = (target[0], target[1], 0.0), (0.0, 0.0, target[2])
    wanted = translation if first is TRANSLATION else rotation
    alone = 1.0 / max(excess(wanted, (2.0, 1.5, 4.0)), max(wheels.use(wanted)) / speed, 1.0)
    reached = (vx, vy, 0.0) if first is TRANSLATION else (0.0, 0.0, wz)
    assert reached == pytest.approx([alone * axis for axis in wanted], abs=1e-9)
    # The second has all that is left: a little more of it is beyond a limit, unless it has what it asked for.
    other, has = (rotation, (0.0, 0.0, wz)) if first is TRANSLATION else (translation, (vx, vy, 0.0))
    more = [own + 1.001 * part + 1e-6 * asked for own, part, asked in zip(reached, has, other, strict=True)]
    beyond = max(
        excess(tuple(more), (2.0, 1.5, 4.0)),
        turning_excess(tuple(more), acceleration),
        max(wheels.use(tuple(more))) / speed,
    )
    assert has == pytest.approx(other, abs=1e-9) or beyond > 1.0


def test_torque_that_is_all_given_holds_both_back() -> None:
    moving = limiter(TRANSLATION)
    moving.reset((0.5, 0.0, 0.5))
    assert moving.step(Twist(1, 0, 0), 0.1, headroom=0.0)[0] == pytest.approx((0.5, 0.0, 0.1))


def test_without_time_nothing_changes() -> None:
    moving = limiter(TRANSLATION)
    moving.reset((0.5, 0.0, 0.5))
    assert moving.step(Twist(1, 0, 0), 0.0)[0] == (0.5, 0.0, 0.5)


# the robot


def edited(saturation: str | None, *, wheels: bool = True) -> str:
    """omni4 whose wheels are the limit: 20 rad/s and 25 rad/s^2, where 1.2 m/s forward and 4 rad/s ask 24."""
    found = robot_text("omni4")
    if saturation is not None:
        found = found.replace('name = "omni4"', f'name = "omni4"\nsaturation = "{saturation}"', 1)
    if wheels:
        found = found.replace(" = 45.0", " = 20.0")
        names = ("front_left", "rear_left", "rear_right", "front_right")
        line = ", ".join(f"{name} = 25.0" for name in names)
        found = found.replace("\n[[bus]]", f"motor_acceleration = {{ {line} }}\n\n[[bus]]", 1)
    return found


def driven(saturation: str, twist: Twist, seconds: float = 2.0) -> World:
    world = World("omni4", edit=lambda _: edited(saturation))
    world.start()
    world.run(seconds, twist)
    assert world.is_in(Mode.DRIVE)
    return world


def limits_told(world: World) -> set[str]:
    told = [outputs.status for _, outputs in world.records[-60:] if outputs.status]
    return {name for status in told for name in status.limits_active}


def test_the_robot_keeps_what_its_file_says() -> None:
    """0.9 m/s forward are 10.23 rad/s of each wheel, 1.1 rad/s are 2.89; turning lets 0.7 x 1.5 = |w v| through."""
    twist = Twist(1.5, 0.0, 3.0)
    both, translation, rotation = (
        driven(name, twist).last.trace.setpoint for name in ("both", "translation", "rotation")
    )
    assert both.wz / both.vx == pytest.approx(2.0)
    assert translation.vx == pytest.approx(1.5)
    assert translation.wz == pytest.approx(min((20.0 * 0.0762 - 1.5 * 0.75**0.5) / 0.2, 0.7 * 1.5 / 1.5))
    assert rotation.wz == pytest.approx(3.0)
    assert rotation.vx == pytest.approx(min((20.0 * 0.0762 - 3.0 * 0.2) / 0.75**0.5, 0.7 * 1.5 / 3.0))


def test_it_says_which_part_is_cut() -> None:
    """Sideways with a turn: 1.4 m/s are 9.19 rad/s of a wheel, so the wheels have room, the floor 1.4/1.4 rad/s."""
    assert limits_told(driven("translation", Twist(0.0, 1.4, 4.0))) == {"turning", "rotation_cut"}
    assert limits_told(driven("rotation", Twist(0.0, 1.4, 4.0))) == {"turning", "translation_cut"}
    assert limits_told(driven("both", Twist(0.0, 1.4, 4.0))) == {"turning"}
    # Forward 1.75 m/s: 19.89 of 20 rad/s; 0.04 rad/s are left, the floor would let 0.6 through.
    assert limits_told(driven("translation", Twist(1.75, 0.0, 0.5))) == {"motor_speed", "rotation_cut"}


@pytest.mark.parametrize("saturation", ["both", "translation", "rotation"])
def test_no_wheel_is_told_to_change_faster_than_it_may(saturation: str) -> None:
    """Commands that jump to and fro; 25 rad/s^2 are 0.1 rad/s in a cycle."""
    world = World("omni4", edit=lambda _: edited(saturation))
    world.start()
    begin = len(world.records)
    for twist in (
        Twist(1.5, 0.5, 3.0),
        Twist(-1.0, 0.5, -4.0),
        Twist(0.0, -1.5, 4.0),
        Twist(1.9, 0.0, 0.0),
        ZERO_TWIST,
    ):
        world.run(0.7, twist)
    world.run(2.0)
    assert world.is_in(Mode.IDLE)
    told = [outputs for _, outputs in world.records[begin:] if outputs.mode in (Mode.DRIVE, Mode.STOPPING)]
    assert largest_change(told) <= 0.1 * (1 + 1e-6)
    assert largest_change(told) > 0.09, "or the test shows nothing"
    assert max(abs(speed or 0.0) for outputs in told for speed in outputs.trace.wheel_setpoints) <= 20.0 * (1 + 1e-9)


def largest_change(told: list[Outputs]) -> float:
    return max(
        abs((new or 0.0) - (old or 0.0))
        for one, other in pairwise(told)
        for old, new in zip(one.trace.wheel_setpoints, other.trace.wheel_setpoints, strict=True)
    )


def test_the_default_is_both_and_the_same_to_the_last_bit() -> None:
    worlds = [World("omni4", edit=lambda _, key=key: edited(key, wheels=False)) for key in (None, "both")]  # type: ignore[misc]
    for world in worlds:
        world.start()
        world.run(0.5, Twist(1.0, 0.4, 2.0))
    frames = [[outputs.frames for _, outputs in world.records] for world in worlds]
    assert frames[0] == frames[1]


@pytest.mark.parametrize("direction", [Twist(0.7, 0.7, 2.0), Twist(-0.9, 0.3, -3.0)])
def test_the_robot_goes_straight_while_it_starts(direction: Twist) -> None:
    """Of the setpoint, in the body frame; 0.5 to the hypotenuse in each part."""
    for saturation in ("translation", "rotation"):
        world = driven(saturation, direction, seconds=1.0)
        for _, outputs in world.records[-240:]:
            vx, vy, _ = outputs.trace.setpoint
            assert vx * direction.vy - vy * direction.vx == pytest.approx(0.0, abs=1e-9 * hypot(*direction[:2]))


def test_a_robot_that_cannot_choose_is_not_asked() -> None:
    with pytest.raises(ConfigError, match=r"robot\.saturation = 'wheels': must be .both., .translation. or .rotation."):
        parse(edited("wheels"), "r.toml")
    chosen = robot_text("moby").replace('name = "moby"', 'name = "moby"\nsaturation = "rotation"', 1)
    with pytest.raises(ConfigError, match=r"saturation = 'rotation': unknown key"):
        parse(chosen, "r.toml")
