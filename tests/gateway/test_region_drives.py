"""Commands that ask for a way round, through the real core, simulated controllers and plant (moby, d1 = 0.25 m)."""

import math
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from gateway.config import ConfigError, RobotConfig, parse
from gateway.core.engine import Engine
from gateway.types import Mode, Region, Twist, TwistFrame
from replay.compare.verify import verify
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from replay.inject.laws import violations
from replay.sessions.reader import open_session
from tests.gateway.test_snapshot import goes_on_byte_for_byte
from tests.recordings import write_drive
from tests.world import World, robot_text

JOINT = 0.4  # rad at the start: the chassis looks 23 degrees to the right of the platform
COMPENSATION = "[robot.compensation]\nregion = 1.57\n\n"
MOTORS = "motor_acceleration = { left = 60.0, right = 60.0, platform = 20.0 }\n\n[[bus]]"
Entry = dict[str, Any]


def text(form: str = "arc", *, bound: float = 0.6, compensation: str = COMPENSATION) -> str:
    section = f'{compensation}[robot.manoeuvre]\nform = "{form}"\nmax_footprint = {bound}\n\n[robot.body]'
    return robot_text("moby").replace("[robot.body]", section, 1).replace("[[bus]]", MOTORS, 1)


@cache
def robot(form: str = "arc", *, bound: float = 0.6, compensation: str = COMPENSATION) -> RobotConfig:
    return parse(text(form, bound=bound, compensation=compensation), "moby")


def say(t: float, speed: float = 0.0, degrees: float = 0.0, region: str = "any", wz: float = 0.0) -> Entry:
    s, c = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    return {"t": t, "command": {"source": "teleop", "vx": speed * c, "vy": speed * s, "wz": wz, "region": region}}


def fault(t: float, kind: str, **more: object) -> Entry:
    return {"t": t, "fault": {"kind": kind, **more}}


def script(*entries: Entry, seconds: float) -> Scenario:
    start = {"joint": {"platform": JOINT}}
    at = [say(0.3), *entries]
    return Scenario.model_validate({"robot": "moby", "seconds": seconds, "at": at, "start": start})


def driven(config: RobotConfig, *entries: Entry, seconds: float) -> list[Moment]:
    moments: list[Moment] = []
    run_scenario(script(*entries, seconds=seconds), config, watch=moments.append)
    return moments


def broken(moments: Sequence[Moment], config: RobotConfig) -> dict[str, list[str]]:
    return {law: words for law, words in violations(moments, config, can_brake=False).items() if words}


def news(moments: Sequence[Moment], prefix: str = "manoeuvre_") -> dict[str, tuple[float, str]]:
    """When each kind of event was told first, and its words."""
    found: dict[str, tuple[float, str]] = {}
    for one in moments:
        for event in one.outputs.events:
            if event.code.startswith(prefix):
                found.setdefault(event.code, (one.t, event.text))
    return found


def states(moments: Sequence[Moment]) -> Iterator[tuple[float, dict[str, float | str | bool | None], tuple[str, ...]]]:
    for one in moments:
        if one.outputs.status is not None and "manoeuvre" in one.outputs.status.chassis:
            yield one.t, one.outputs.status.chassis, one.outputs.status.limits_active


def between(moments: Sequence[Moment], start: float, end: float = math.inf) -> list[Moment]:
    return [one for one in moments if start <= one.t <= end]


def farthest(moments: Sequence[Moment]) -> float:
    """How far the real robot gets from where it is first."""
    x, y, _ = moments[0].truth.pose
    return max(math.hypot(one.truth.pose.x - x, one.truth.pose.y - y) for one in moments)


def speed(one: Moment) -> float:
    return one.speed


def gamma(one: Moment) -> float | None:
    return one.outputs.trace.chassis[0]


def wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)


def first_turn(degrees: float, region: str) -> float:
    """By which the chassis must turn: it looks to -JOINT, and is to look along the motion, or away from it."""
    return wrapped(math.radians(degrees) + JOINT - (math.pi if region == "pull" else 0.0))


@pytest.mark.parametrize("degrees", range(0, 360, 45))
@pytest.mark.parametrize("region", ["push", "pull"])
@pytest.mark.parametrize("form", ["arc", "closed"])
def test_from_rest_it_turns_round_as_it_told_and_then_drives(form: str, region: str, degrees: float) -> None:
    turn, config = first_turn(degrees, region), robot(form)
    moments = driven(config, say(0.6, 0.5, degrees, region), seconds=10.5 if form == "closed" else 6.0)
    assert broken(moments, config) == {}
    last = moments[-1]
    assert last.speed == pytest.approx(0.5, abs=0.01)
    assert math.cos(gamma(last) or 0.0) * (1.0 if region == "push" else -1.0) > 0.9
    assert abs(wrapped(math.atan2(last.truth.twist.vy, last.truth.twist.vx) - math.radians(degrees))) < 0.05
    told = news(moments)
    if abs(turn) <= 1.0:
        assert told == {}
        return
    begin, end = told["manoeuvre_planned"][0], told["manoeuvre_done"][0]
    planned = next(facts for t, facts, _ in states(moments) if t == begin)
    assert planned["manoeuvre"] == "planned"
    footprint, duration = planned["manoeuvre_footprint"], planned["manoeuvre_duration"]
    assert isinstance(footprint, float)
    assert isinstance(duration, float)
    if form == "arc":
        assert footprint == pytest.approx(0.5 * abs(math.sin(turn / 2.0)), abs=1e-3)
    for one in between(moments, begin, begin + 0.196):
        assert not any(one.outputs.trace.wheel_setpoints), "it is told before it moves"
    during = between(moments, begin, end)
    assert farthest(during) == pytest.approx(footprint, abs=0.006)
    assert end - begin == pytest.approx(duration, rel=0.1)
    start, ended = during[0].truth.pose, during[-1].truth.pose
    away = math.hypot(ended.x - start.x, ended.y - start.y)
    assert away == pytest.approx(footprint, abs=0.006) if form == "arc" else away < 0.01
    assert max(abs(one.truth.pose.theta - start.theta) for one in during) < 0.01
    assert max(map(speed, during)) < 0.5
    at_work = [limits for t, _, limits in states(moments) if begin < t < end]
    assert all("manoeuvre" in limits for limits in at_work)


@pytest.mark.parametrize("form", ["arc", "closed"])
def test_it_lasts_as_long_as_it_says_where_the_body_may_hardly_jerk(form: str) -> None:
    """0.5 m/s^3, where the bundled file has 4: a closed path takes one second more, and was told to take as long."""
    soft = text(form).replace("jerk = { vx = 4.0, vy = 4.0", "jerk = { vx = 0.5, vy = 0.5")
    moments = driven(parse(soft, "moby"), say(0.6, 0.5, 180.0, "push"), seconds=11.0)
    told = news(moments)
    begin, end = told["manoeuvre_planned"][0], told["manoeuvre_done"][0]
    duration = next(facts["manoeuvre_duration"] for t, facts, _ in states(moments) if t == begin)
    assert end - begin == pytest.approx(duration, rel=0.06)


@pytest.mark.parametrize("form", ["arc", "closed"])
def test_no_wheel_is_asked_for_more_than_its_limit(form: str) -> None:
    """Turned round, braked in the middle of it, and turned round again."""
    moments = driven(
        robot(form),
        say(0.6, 1.0, 180.0, "push"),
        say(1.9, 1.0, 90.0, "push"),
        say(9.0, 1.0, 0.0, "pull"),
        seconds=18.0,
    )
    assert {"manoeuvre_ended", "manoeuvre_done"} <= set(news(moments))
    worst = [0.0, 0.0, 0.0]
    for before, now in pairwise(moments):
        pairs = zip(before.outputs.trace.wheel_setpoints, now.outputs.trace.wheel_setpoints, strict=True)
        worst = [
            was if a is None or b is None else max(was, abs(b - a) * 250.0)
            for was, (a, b) in zip(worst, pairs, strict=True)
        ]
    assert max(worst[:2]) <= 60.0 * (1.0 + 1e-6)
    assert worst[2] <= 20.0 * (1.0 + 1e-6)


# Half way of the first turn, and on the straight way of the closed path.
STAGES = [("arc", 1.7, "turning"), ("closed", 2.6, "driving")]
ENDS: dict[str, Entry] = {
    "zero": say(0.0),
    "silence": {"silence": "teleop"},
    "estop": {"request": "estop"},
    "shutdown": {"request": "shutdown"},
    "angle": {"fault": {"kind": "encoder_jump", "motor": "platform", "value": 1.0}},
    "power": {"fault": {"kind": "power_off", "motor": "platform"}},
    "bus": {"fault": {"kind": "bus_down", "seconds": 0.4}},
}


@pytest.mark.parametrize("name", ENDS)
@pytest.mark.parametrize(("form", "t", "stage"), STAGES, ids=["turning", "driving"])
def test_what_ends_it_ends_it_for_good(form: str, t: float, stage: str, name: str) -> None:
    """It brakes within 0.2 m, and nothing moves after that though everything else is as it was.

    Controllers that hear nothing for 0.1 s let their motors go: 0.4 m.
    """
    config = robot(form)
    moments = driven(config, say(0.6, 0.5, 180.0, "push"), {**ENDS[name], "t": t}, seconds=t + 4.0)
    before = [facts["manoeuvre"] for at, facts, _ in states(moments) if at < t]
    assert before[-1] == stage
    assert max(map(speed, between(moments, t - 0.1, t))) > 0.15
    after = between(moments, t)
    assert farthest(after) < (0.4 if name == "bus" else 0.2)
    assert max(map(speed, [moments[-1], *between(moments, t + 1.5 + (name == "bus"))])) < 0.02
    codes = set(news(moments))
    assert "manoeuvre_done" not in codes
    assert ("manoeuvre_ended" in codes) is (name != "estop")
    assert broken(moments, config) == {}


@pytest.mark.parametrize("name", ["zero", "silence"])
@pytest.mark.parametrize(("form", "t", "per_speed"), [("arc", 1.7, 8.0), ("closed", 2.6, 10.0)])
def test_it_brakes_as_the_body_brakes(form: str, t: float, per_speed: float, name: str) -> None:
    """0.8 m/s^2; rad/s of a wheel per m/s are d2/(2 d1 R) = 8 across the chassis and 1/R = 10 along it.

    Measured is the motion of the manoeuvre, which is no reason to take a setpoint along the command back to it.
    """
    moments = driven(robot(form), say(0.6, 0.5, 180.0, "push"), {**ENDS[name], "t": t}, seconds=t + 1.5)
    told = [one.outputs.trace.wheel_setpoints[0] or 0.0 for one in between(moments, t)]
    assert max(abs(b - a) * 250.0 for a, b in pairwise(told)) <= 0.8 * per_speed * 1.01


@pytest.mark.parametrize("other", [say(1.7, 0.5, 160.0, "push"), say(1.7, 0.5, 180.0, "pull")], ids=["way", "region"])
def test_another_command_ends_it_and_is_looked_at_from_rest(other: Entry) -> None:
    moments = driven(robot(), say(0.6, 0.5, 180.0, "push"), other, seconds=9.0)
    told = news(moments)
    assert told["manoeuvre_ended"][0] == pytest.approx(1.7, abs=0.005)
    assert told["manoeuvre_ended"][1] == "another command"
    plans = [one.t for one in moments for event in one.outputs.events if event.code == "manoeuvre_planned"]
    rest = min(one.t for one in between(moments, 1.71) if one.speed < 0.02)
    assert len(plans) <= 2
    assert all(t < 1.0 or t >= rest - 0.05 for t in plans)
    vx, vy = other["command"]["vx"], other["command"]["vy"]
    assert moments[-1].truth.twist[:2] == pytest.approx((vx, vy), abs=0.03)
    sign = 1.0 if other["command"]["region"] == "push" else -1.0
    assert sign * math.cos(gamma(moments[-1]) or 0.0) > 0.9


def test_limping_it_is_turned_no_further_and_refused() -> None:
    """The joint has lost its torque: the others may go on, but the platform would not keep its heading."""
    limp = '[degraded]\nmotor_lost = "limp"\nencoder_lost = "limp"\n\n[limits]'
    config = parse(text().replace("[limits]", limp, 1), "moby")
    lost = fault(1.7, "torque_lost", motor="platform")
    moments = driven(config, say(0.6, 0.5, 180.0, "push"), lost, seconds=6.5)
    t, words = news(moments)["manoeuvre_ended"]
    assert words == "a motor is lost"
    assert {one.outputs.mode for one in between(moments, t)} == {Mode.DEGRADED}
    assert news(moments, "region_")["region_refused"][1].startswith("a motor is lost: no manoeuvre leads to the region")
    assert moments[-1].speed < 1e-3
    assert broken(moments, config) == {}


def test_a_command_of_any_region_ends_it_and_drives_from_rest() -> None:
    moments = driven(robot(), say(0.6, 0.5, 180.0, "push"), say(1.7, 0.5, 90.0), seconds=6.0)
    assert news(moments)["manoeuvre_ended"][0] == pytest.approx(1.7, abs=0.005)
    assert min(one.speed for one in between(moments, 1.8, 3.5)) < 0.02
    assert moments[-1].truth.twist[:2] == pytest.approx((0.0, 0.5), abs=0.03)


def test_a_command_that_turns_a_little_goes_on_with_it() -> None:
    moments = driven(robot(), say(0.6, 0.5, 180.0, "push"), say(1.7, 0.5, 170.0, "push"), seconds=5.0)
    assert set(news(moments)) == {"manoeuvre_planned", "manoeuvre_done"}


def test_every_plan_is_in_the_state_at_once() -> None:
    """Of the second within a second no event is told, and the next state would be due 40 ms later."""
    again = say(0.65), say(0.76, 0.5, 180.0, "push")
    moments = driven(robot(), say(0.6, 0.5, 180.0, "push"), *again, seconds=1.2)
    planned = [t for t, facts, _ in states(moments) if facts["manoeuvre"] == "planned"]
    assert planned[0] == pytest.approx(0.6, abs=0.005)
    assert next(t for t in planned if t > 0.7) == pytest.approx(0.76, abs=0.005)


def test_a_command_for_much_less_slows_it_down_and_not_at_once() -> None:
    """0.8 m/s^2, 8 rad/s^2 of a wheel, though no motor has a limit of its own."""
    config = parse(text().replace(MOTORS, "[[bus]]", 1), "moby")
    moments = driven(config, say(0.6, 0.5, 180.0, "push"), say(1.7, 0.01, 180.0, "push"), seconds=4.0)
    told = [one.outputs.trace.wheel_setpoints[0] or 0.0 for one in between(moments, 1.6)]
    assert max(abs(b - a) * 250.0 for a, b in pairwise(told)) < 10.0
    assert max(map(speed, between(moments, 3.0))) < 0.012
    assert set(news(moments)) == {"manoeuvre_planned"}
    assert broken(moments, config) == {}


def test_it_is_as_slow_as_it_is_told_to_be() -> None:
    moments = driven(robot(), say(0.6, 0.1, 180.0, "push"), seconds=6.0)
    assert max(map(speed, moments)) < 0.11
    assert max(map(speed, between(moments, 3.0, 5.0))) > 0.09


def test_one_that_leads_too_far_is_refused_and_moves_nothing() -> None:
    """0.49 m of an allowed 0.3; until another direction is asked for, which needs none."""
    moments = driven(robot(bound=0.3), say(0.6, 0.5, 180.0, "push"), say(3.0, 0.5, 0.0, "push"), seconds=5.0)
    told = news(moments, "region_")
    assert list(told) == ["region_refused"]
    t, words = told["region_refused"]
    assert t == pytest.approx(0.6, abs=0.01)
    assert words.startswith("it would leave its place by 0.490 m to get into the push region: robot.manoeuvre.max_foot")
    assert not any(any(one.outputs.trace.wheel_setpoints) for one in between(moments, 0.6, 2.99))
    assert sum(event.code == "region_refused" for one in moments for event in one.outputs.events) == 1
    held = [(facts["manoeuvre"], limits) for at, facts, limits in states(moments) if 0.7 < at < 2.9]
    assert set(held) == {("refused", ("region",))}
    assert moments[-1].truth.twist.vx == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([say(0.6, 0.1, 180.0, "pull", wz=0.9)], "the path turns tighter than axle_offset = 0.25 m"),
        ([say(0.6, 0.1, 0.0, "push", wz=-0.9)], "the path turns tighter than axle_offset = 0.25 m"),
        ([{"t": 0.5, "set": {"compensation_gain": 1.0}}, say(0.6, 0.5, 180.0, "pull")], "compensation_gain must be"),
    ],
)
def test_a_region_that_nothing_keeps_it_in_is_refused(entries: list[Entry], words: str) -> None:
    moments = driven(robot(), *entries, seconds=2.0)
    assert words in news(moments, "region_")["region_refused"][1]
    assert farthest(moments) < 1e-3


@pytest.mark.parametrize("region", ["push", "any"])
@pytest.mark.parametrize("forward", [0.25, 0.3])
def test_round_a_tight_bend_it_stays_pushed(region: str, forward: float) -> None:
    """1.1 and 1.3 d1, at 1.12 and 0.85 rad. It was turned to be pulled, told to be held, or to and fro for ever."""
    moments = driven(robot(), say(0.6, forward, -math.degrees(JOINT), region, wz=0.9), seconds=8.0)
    assert moments[-1].outputs.trace.chassis[0] == pytest.approx(math.asin(0.25 * 0.9 / forward), abs=0.04)
    assert moments[-1].speed == pytest.approx(forward, abs=0.003)
    assert news(moments, "pull_lost") == {}


def test_round_a_tight_bend_it_is_pulled_if_that_is_asked_for() -> None:
    """At 2.02 rad; it begins 1 rad away, beyond neutral steering."""
    moments = driven(robot(), say(0.6, 0.25, 60.0 - math.degrees(JOINT), "pull", wz=0.9), seconds=8.0)
    assert news(moments) == {}
    assert moments[-1].outputs.trace.chassis[0] == pytest.approx(math.pi - math.asin(0.9), abs=0.04)


@pytest.mark.parametrize("region", ["push", "pull"])
def test_over_the_ground_a_velocity_leads_straight_on_whatever_the_platform_turns_by(region: str) -> None:
    """0.2 m/s at 0.9 rad/s would be tighter than 0.25 m if it were the body's."""
    world = World("moby", edit=lambda _: text())
    world.start()
    world.run(9.0, Twist(-0.2, 0.03, 0.9), frame=TwistFrame.ODOM, region=Region(region))
    assert not {"region_refused", "pull_lost"} & set(world.codes())
    sign = 1.0 if region == "push" else -1.0
    assert sign * math.cos(world.last.trace.chassis[0] or 0.0) > 0.99
    assert world.bus.robot.truth.twist.wz == pytest.approx(0.9, abs=0.01)


def test_turning_on_the_spot_is_no_direction() -> None:
    moments = driven(robot(), say(0.6, 0.0, 0.0, "pull", wz=0.5), seconds=3.0)
    assert moments[-1].truth.twist.wz == pytest.approx(0.5, abs=0.01)
    assert news(moments) == {}


def test_in_motion_the_wrong_way_round_it_rests_first() -> None:
    """Pushed at 0.5 m/s; to be pulled the same way it brakes along its path, and turns at its end."""
    moments = driven(robot(), say(0.6, 0.5, 0.0), say(2.6, 0.5, 0.0, "pull"), seconds=9.0)
    told = news(moments)
    planned = told["manoeuvre_planned"][0]
    assert planned > 2.6 + 0.5 / 0.8
    braking = [facts for t, facts, _ in states(moments) if 2.61 < t < planned]
    assert {facts["manoeuvre"] for facts in braking} == {"resting"}
    assert {facts["manoeuvre_reason"] for facts in braking} == {
        "it moves, and is not in the pull region of the command"
    }
    (at_plan,) = between(moments, planned - 0.001, planned + 0.001)
    assert at_plan.speed < 0.03
    assert max(abs(one.truth.twist.vy) for one in between(moments, 2.6, planned)) < 0.01
    assert moments[-1].truth.twist.vx == pytest.approx(0.5, abs=0.01)
    assert math.cos(gamma(moments[-1]) or 0.0) < -0.9


def test_a_gain_that_keeps_nothing_pulled_stops_it_while_it_still_lies_well() -> None:
    moments = driven(robot(), say(0.6, 0.8, 180.0, "pull"), {"t": 5.0, "set": {"compensation_gain": 0.5}}, seconds=9.0)
    assert between(moments, 4.9, 5.0)[0].speed == pytest.approx(0.8, abs=0.01)
    told = news(moments, "region_")
    assert list(told) == ["region_refused"]
    assert max(map(speed, between(moments, told["region_refused"][0]))) < 0.03
    moving = [gamma(one) for one in between(moments, 5.0) if one.outputs.trace.setpoint != (0.0, 0.0, 0.0)]
    assert max(math.cos(angle) for angle in moving if angle is not None) < -0.95


def test_a_region_that_is_lost_stops_it_until_zero_is_commanded() -> None:
    """Only errors up to 0.01 rad are corrected any more, and a push of 1300 N across makes one of 0.014."""
    moments = driven(
        robot(),
        say(0.6, 0.8, 90.0, "pull"),
        {"t": 4.5, "set": {"compensation_region": 0.01}},
        fault(5.0, "push", value=1300.0, seconds=0.2),
        {"t": 8.0, "set": {"compensation_region": 1.5}},
        say(9.0),
        say(9.5, 0.8, 90.0, "pull"),
        seconds=13.0,
    )
    told = news(moments, "region_")
    assert list(told) == ["region_lost"]
    t, words = told["region_lost"]
    assert 5.0 < t < 5.5
    assert words == "the chassis has left the pull region; it stays at rest until zero is commanded"
    assert between(moments, t)[0].speed > 0.7
    assert max(map(speed, between(moments, t + 1.5, 9.5))) < 0.02
    held = [(facts["manoeuvre"], limits[0]) for at, facts, limits in states(moments) if 7.0 < at < 8.9]
    assert set(held) == {("lost", "region")}
    assert moments[-1].truth.twist.vy == pytest.approx(0.8, abs=0.02)
    assert math.cos(gamma(moments[-1]) or 0.0) < -0.9


def test_without_compensation_only_push_may_be_asked_for() -> None:
    config = robot(compensation="")
    moments = driven(config, say(0.6, 0.5, 180.0, "push"), say(5.0, 0.5, 180.0, "pull"), seconds=7.0)
    assert "manoeuvre_done" in news(moments)
    assert news(moments, "refused")["refused_unsupported"][1] == (
        "teleop: region = 'pull': must be 'any' or 'push' on this chassis: "
        "[robot.compensation] in the robot file allows 'pull'"
    )


def test_an_emergency_stop_while_the_wheels_get_faster_is_no_runaway_of_theirs() -> None:
    """A motor a little ahead of its setpoint was once taken for one, and everything let go instead of braked."""
    entries = say(0.6, 0.9, 90.0), {"t": 1.448, "request": "estop"}
    moments = driven(robot(), *entries, seconds=2.5)
    assert news(moments, "fault") == {}
    assert moments[-1].outputs.mode is Mode.ESTOP
    assert max(map(speed, between(moments, 1.6))) < 0.05


def test_a_command_without_a_region_is_driven_as_without_the_section() -> None:
    entries = say(0.6, 0.8, 100.0), say(3.0, 0.5, 270.0, wz=0.4)
    with_it = driven(robot(), *entries, seconds=6.0)
    without = parse(text().replace('[robot.manoeuvre]\nform = "arc"\nmax_footprint = 0.6\n\n', ""), "moby")
    for one, other in zip(with_it, driven(without, *entries, seconds=6.0), strict=True):
        assert one.outputs.frames == other.outputs.frames
    assert {facts["manoeuvre"] for _, facts, _ in states(with_it)} == {"none"}


def test_a_wheel_whose_angle_jumps_does_not_lead_it_away() -> None:
    """By 30 rad back, 1.5 m of way: it goes a fifth beyond the 0.49 m, brakes, and stays there."""
    jump = fault(2.6, "encoder_jump", motor="left", value=-30.0)
    moments = driven(robot("closed"), say(0.6, 0.5, 180.0, "push"), jump, seconds=8.0)
    assert news(moments)["manoeuvre_ended"][1].startswith("driven further than planned")
    assert 0.5 < farthest(between(moments, 0.6)) < 1.2 * 0.49 + 0.15 * 0.32 + 0.1
    assert max(map(speed, between(moments, 6.0))) < 0.01


def test_a_wheel_whose_angle_jumps_ahead_does_not_stop_it_dead() -> None:
    """By 30 rad, so that the way seems to be done: it brakes by 0.8 m/s^2, 8 rad/s^2 of a wheel, and goes on."""
    config = parse(text("closed").replace(MOTORS, "[[bus]]", 1), "moby")
    jump = fault(2.6, "encoder_jump", motor="left", value=30.0)
    moments = driven(config, say(0.6, 0.5, 180.0, "push"), jump, seconds=8.0)
    told = [one.outputs.trace.wheel_setpoints[0] or 0.0 for one in between(moments, 2.5)]
    assert told[0] > 2.9  # rad/s
    assert max(abs(b - a) * 250.0 for a, b in pairwise(told)) < 10.0
    assert broken(moments, config) == {}


@pytest.mark.parametrize("lost", [0.02, 0.1])
def test_frames_that_are_lost_do_not_lead_it_astray(lost: float) -> None:
    moments = driven(robot("closed"), fault(0.5, "frames_lost", value=lost), say(0.6, 0.5, 180.0, "push"), seconds=10.0)
    told = news(moments)
    during = between(moments, told["manoeuvre_planned"][0], told["manoeuvre_done"][0])
    start, end = during[0].truth.pose, during[-1].truth.pose
    assert math.hypot(end.x - start.x, end.y - start.y) < 0.02
    assert math.cos(gamma(moments[-1]) or 0.0) > 0.9


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('form = "arc"', 'form = "spiral"', "form"),
        ("max_footprint = 0.6\n", "", "max_footprint"),
        ("max_footprint = 0.6", "max_footprint = 0.0", "max_footprint"),
    ],
)
def test_what_is_no_manoeuvre_is_refused(old: str, new: str, words: str) -> None:
    assert old in text()
    with pytest.raises(ConfigError, match=words):
        parse(text().replace(old, new), "moby")


COURSE = [
    say(0.6, 0.5, 180.0, "push"),
    say(1.7, 0.5, 90.0, "push"),
    say(9.5, 0.5, 0.0),
    say(10.0, 0.5, 0.0, "pull"),
    {"t": 12.5, "silence": "teleop"},
]


@pytest.mark.parametrize("form", ["arc", "closed"])
def test_a_snapshot_of_any_cycle_goes_on_byte_for_byte(form: str) -> None:
    config = robot(form)
    moments = driven(config, *COURSE, seconds=14.0)
    assert {"manoeuvre_planned", "manoeuvre_ended", "manoeuvre_done"} <= set(news(moments))
    plans = [event for one in moments for event in one.outputs.events if event.code == "manoeuvre_planned"]
    assert len(plans) == 3
    assert goes_on_byte_for_byte([(one.inputs, one.outputs) for one in moments], config) > 100


def test_a_recorded_manoeuvre_is_verified(tmp_path: Path) -> None:
    world = World("moby", edit=lambda _: text())
    world.start()
    world.run(4.0, Twist(-0.5, 0.1, 0.0), region=Region.PUSH)
    assert "manoeuvre_done" in world.codes()
    verdict = verify(open_session(write_drive(tmp_path, world, batch=200, snapshots=True)))
    assert (verdict.exit_code, verdict.identical) == (0, True)
    engine = Engine(world.config)
    forgetful = [
        inputs._replace(commands=tuple(c._replace(region=Region.ANY) for c in inputs.commands))
        for inputs, _ in world.records
    ]
    assert [engine.step(inputs).frames for inputs in forgetful] != [outputs.frames for _, outputs in world.records]
