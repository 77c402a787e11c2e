"""The offset-differential robot in its pull region, through the real core, simulated controllers and plant."""

import math
from collections.abc import Mapping
from itertools import pairwise

import pytest

from drivers.contract import MotorState
from gateway.config import ConfigError, RobotConfig, parse
from gateway.control.compensation import Compensation, RegionAt
from gateway.control.drive_law import Measured
from gateway.control.offset_law import OffsetDifferentialLaw
from gateway.core.examination import examine
from gateway.types import ZERO_TWIST, BusEventKind, Mode, RequestKind, Twist
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from tests.gateway.test_engine_rules import Stand
from tests.world import World, robot_text

COMPENSATION = "[robot.compensation]\ngain = 2.0\nregion = 1.57\n\n[robot.body]"
LIMITS = "motor_acceleration = { left = 40.0, right = 40.0, platform = 15.0 }\n\n[[bus]]"
NOTHING: Mapping[str, str] = {}
# The chassis looks to -y: a motion along y is pulled, and pushes are along x.
PULLED = {"platform": math.pi / 2}


def compensated(text: str) -> str:
    return text.replace("[robot.body]", COMPENSATION, 1)


def robot(edits: Mapping[str, str] = NOTHING, *, compensation: bool, limits: bool = False) -> RobotConfig:
    text = robot_text("moby")
    if compensation:
        text = compensated(text)
    if limits:
        text = text.replace("[[bus]]", LIMITS, 1)
    for old, new in edits.items():
        text = text.replace(old, new)
    return parse(text, "moby")


def driven(config: RobotConfig, *entries: dict[str, object], seconds: float, seed: int = 1) -> list[Moment]:
    still = {"t": 0.3, "command": {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}}
    script = Scenario.model_validate(
        {
            "robot": "moby",
            "seconds": seconds,
            "seed": seed,
            "at": [still, *entries],
            "start": {"joint": PULLED},
        }
    )
    moments: list[Moment] = []
    run_scenario(script, config, watch=moments.append)
    return moments


def command(t: float, vx: float, vy: float = 0.0, wz: float = 0.0) -> dict[str, object]:
    return {"t": t, "command": {"source": "teleop", "vx": vx, "vy": vy, "wz": wz}}


def push(t: float, newton: float, seconds: float = 0.1) -> dict[str, object]:
    return {"t": t, "fault": {"kind": "push", "value": newton, "seconds": seconds}}


def gammas(moments: list[Moment]) -> list[float]:
    """gamma of the motion that is driven, wherever it has a direction."""
    return [one.outputs.trace.chassis[0] or 0.0 for one in moments if one.outputs.trace.chassis[0] is not None]


def worst_rates(moments: list[Moment], config: RobotConfig) -> list[float]:
    """The fastest change of what each wheel is told, rad/s^2."""
    worst = [0.0, 0.0, 0.0]
    for before, now in pairwise(moments):
        pairs = zip(before.outputs.trace.wheel_setpoints, now.outputs.trace.wheel_setpoints, strict=True)
        for index, (a, b) in enumerate(pairs):
            if a is not None and b is not None:
                worst[index] = max(worst[index], abs(b - a) * config.loop.rate)
    return worst


PUSHES = [push(2.0 + 4.0 * k, (-1.0) ** k * 250.0) for k in range(14)]  # along x of the world; it drives along y


@pytest.mark.parametrize("rate", [250.0, 50.0], ids=["4 ms", "20 ms"])
def test_pulled_at_top_speed_for_a_minute_with_pushes(rate: float) -> None:
    """With compensation it stays pulled, without it is pushed before long. 1.2 m/s, a push of 25 N s every 4 s."""
    edits = {"rate = 250.0\n": f"rate = {rate}\n", "feedback_rate = 250.0": f"feedback_rate = {rate}"}
    steady = driven(robot(edits, compensation=True), command(0.6, 0.0, 1.2), *PUSHES, seconds=60.0)
    last = steady[-1].outputs
    assert last.mode is Mode.DRIVE
    assert last.trace.chassis[2] == pytest.approx(0.0, abs=0.02)
    late = gammas([one for one in steady if one.t > 4.0])
    assert min(abs(gamma) for gamma in late) > math.pi / 2
    flipped = driven(robot(edits, compensation=False), command(0.6, 0.0, 1.2), *PUSHES[:3], seconds=20.0)
    assert abs(gammas(flipped)[-1]) < 0.1


def test_what_it_knows_of_itself_is_in_its_state_and_trace() -> None:
    moments = driven(robot(compensation=True), command(0.6, 0.0, 1.2), seconds=6.0)
    status = next(one.outputs.status for one in reversed(moments) if one.outputs.status)
    assert status is not None
    assert status.chassis["region"] == "pull"
    assert status.chassis["saturated"] is False
    gamma, goal, error, correction, *_ = moments[-1].outputs.trace.chassis
    assert gamma == pytest.approx(math.pi, abs=0.02) or gamma == pytest.approx(-math.pi, abs=0.02)
    assert goal == pytest.approx(math.pi)
    assert error is not None
    assert correction == pytest.approx(-2.0 * error, abs=0.02)
    first = moments[0].outputs.trace.chassis
    assert first[0] is None  # at rest


def test_it_never_changes_the_speed() -> None:
    """What the wheels are told is as fast as the setpoint, corrected or not: by the kinematics' own geometry."""
    config = robot(compensation=True)
    moments = driven(config, command(0.6, 0.0, 1.2), push(3.0, 300.0), push(5.0, -300.0), seconds=8.0)
    for one in moments:
        trace = one.outputs.trace
        if one.outputs.mode is not Mode.DRIVE or trace.wheel_setpoints[0] is None or trace.wheel_setpoints[1] is None:
            continue
        left, right = trace.wheel_setpoints[:2]
        assert left is not None
        assert right is not None
        along, turn = 0.1 * (left + right) / 2.0, 0.1 * (right - left) / 0.4
        assert math.hypot(along, 0.25 * turn) == pytest.approx(math.hypot(*trace.setpoint[:2]), rel=1e-9, abs=1e-12)


def test_without_compensation_it_slows_before_it_flips_and_keeps_its_path() -> None:
    """Wheels that change by 40 rad/s^2 at most: 0.84 m/s in the flip instead of 1.2; none is asked for more."""
    config = robot(compensation=False, limits=True)
    moments = driven(config, command(0.6, 0.0, 1.2), push(3.0, 60.0), seconds=10.0)
    rates = worst_rates(moments, config)
    assert rates[0] <= 40.0 * (1.0 + 1e-6)
    assert rates[1] <= 40.0 * (1.0 + 1e-6)
    assert rates[2] <= 15.0 * (1.0 + 1e-6)
    assert any("flip" in (one.outputs.status.limits_active if one.outputs.status else ()) for one in moments)
    speeds = [math.hypot(*one.outputs.trace.setpoint[:2]) for one in moments if one.t > 3.0]
    assert min(speeds) == pytest.approx(0.84, abs=0.06)
    assert speeds[-1] == pytest.approx(1.2)
    assert abs(gammas(moments)[-1]) < 0.1
    free = driven(robot(compensation=False), command(0.6, 0.0, 1.2), push(3.0, 60.0), seconds=10.0)
    assert max(worst_rates(free, config)[:2]) > 55.0


@pytest.mark.parametrize("compensation", [True, False])
def test_no_wheel_is_asked_for_more_than_its_limit_whatever_happens(compensation: bool) -> None:
    """Reversals, pushes and turns on the spot, pulled and pushed."""
    config = robot(compensation=compensation, limits=True)
    entries = [
        command(0.6, 0.0, 1.0),
        push(2.0, 300.0),
        command(3.0, 0.3, -1.0, 0.5),
        push(4.0, -300.0),
        command(5.0, 0.0, 1.2, -1.0),
        command(7.0, 0.5, -1.0, 0.8),
        push(7.5, 200.0),
    ]
    rates = worst_rates(driven(config, *entries, seconds=10.0), config)
    assert rates[0] <= 40.0 * (1.0 + 1e-6)
    assert rates[1] <= 40.0 * (1.0 + 1e-6)
    assert rates[2] <= 15.0 * (1.0 + 1e-6)


@pytest.mark.parametrize("turned", [(0.5, 1.09), (1.2, 0.0)])
def test_before_the_limits_of_the_body_the_correction_loses_the_robot(turned: tuple[float, float]) -> None:
    """The same correction of the same commands by a commander: the ramps make it late, and a turn flips the chassis."""
    before, behind = World("moby", joint_angles=PULLED), World("moby", joint_angles=PULLED, edit=compensated)
    compensation = Compensation(gain=2.0, regions=(RegionAt(0.0, 1.57),), axle_offset=0.25, authority=12.0)
    for world in (before, behind):
        world.start()
    for cycle in range(2000):
        wanted = (0.0, 1.2) if cycle < 1000 else turned
        angle = before.last.trace.wheel_positions[2]
        vx, vy, _ = compensation.turn(*wanted, joint=angle, path_rate=0.0, dt=0.004)
        before.cycle(commands=[before.command(Twist(vx, vy, 0.0))])
        behind.cycle(commands=[behind.command(Twist(*wanted, 0.0))])
    assert before.is_in(Mode.DRIVE)
    assert behind.is_in(Mode.DRIVE)
    assert abs(before.last.trace.chassis[0] or 0.0) < 0.01  # pushed
    assert abs(behind.last.trace.chassis[0] or 0.0) == pytest.approx(math.pi, abs=0.01)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("region = 1.57", "region = 1.6", "allowed up to 1.571 rad with gain = 2"),
        ("gain = 2.0", "gain = 3.0", "allowed up to 0.7854 rad with gain = 3"),
        ("gain = 2.0", "gain = -1.0", "gain"),
        ("region = 1.57", "region = [{ speed = 1.0, region = 1.0 }, { speed = 0.5, region = 1.2 }]", "must grow"),
        ("region = 1.57", "region = []", "region"),
        ("region = 1.57", "region = true", "region"),
    ],
)
def test_what_cannot_work_is_refused(old: str, new: str, words: str) -> None:
    assert old in COMPENSATION
    with pytest.raises(ConfigError, match=words):
        parse(robot_text("moby").replace("[robot.body]", COMPENSATION.replace(old, new), 1), "moby")


def test_the_widest_region_of_a_robot_file_can_be_set_too() -> None:
    """A gain of 1 corrects errors of half a turn."""
    wide = compensated(robot_text("moby")).replace("gain = 2.0\nregion = 1.57", f"gain = 1.0\nregion = {math.pi}", 1)
    world = World("moby", joint_angles=PULLED, edit=lambda _: wide)
    (region,) = [one for one in world.engine._settings.describe() if one.name == "compensation_region"]
    assert region.low <= region.value <= region.high


def test_a_loop_too_slow_for_compensation_is_refused_where_it_is_used() -> None:
    """d1 = 20 mm: 18 ms (1.0986 d1/c at 1.2 m/s) at most; the loop has 20."""
    edits = {"axle_offset = 0.25": "axle_offset = 0.02", "[loop]\nrate = 250.0": "[loop]\nrate = 50.0"}
    with pytest.raises(ConfigError, match=r"loop\.rate = 50 Hz: too slow for compensation"):
        examine(robot(edits, compensation=True), "moby")
    assert any("too slow for compensation" in text for text in examine(robot(edits, compensation=False), "m").warnings)


def test_feedback_too_old_for_compensation_is_refused_in_words() -> None:
    edits = {"axle_offset = 0.25": "axle_offset = 0.02", "feedback_rate = 250.0": "feedback_rate = 20.0"}
    with pytest.raises(ConfigError, match=r"no rate is enough, the feedback of the motors is too old"):
        examine(robot(edits, compensation=True), "moby")


def test_motors_that_follow_slowly_make_a_stop_longer_and_too_slowly_are_refused() -> None:
    """From 22 and 7 rad/s by 40 and 15 rad/s^2: 0.55 s and 0.47 s more, at 1.2 m/s each way."""
    alone, limited = (examine(robot(compensation=False, limits=limits), "moby") for limits in (False, True))
    assert limited.stopping_time_s == pytest.approx(alone.stopping_time_s + 22.0 / 40.0)
    assert limited.stopping_distance_m == pytest.approx(alone.stopping_distance_m + 1.2 * 2.0**0.5 * 22.0 / 40.0)
    crawling = robot({"left = 40.0": "left = 1.0"}, compensation=False, limits=True)
    with pytest.raises(ConfigError, match=r"24\.5 s .*the motors alone need 22\.0 s of it: raise limits\.motor_acc"):
        examine(crawling, "moby")


@pytest.mark.parametrize("most", [10.0, 40.0])
def test_it_rests_within_the_time_that_is_told(most: float) -> None:
    edits = {"left = 40.0, right = 40.0, platform = 15.0": f"left = {most}, right = {most}, platform = {most}"}
    config = robot(edits, compensation=False, limits=True)
    moments = driven(config, command(0.6, 0.0, 1.2), {"t": 5.0, "silence": "teleop"}, seconds=11.0)
    assert max(map(abs, moments[1200].truth.twist)) > 1.0
    due = 5.0 + 0.3 + examine(config, "moby").stopping_time_s + 0.25
    rest = next(one.t for one in moments if one.t > 5.5 and one.outputs.mode is Mode.IDLE)
    assert rest < due


def slow_wheels(text: str) -> str:
    return text.replace("[[bus]]", LIMITS.replace("40.0", "5.0"), 1)


@pytest.mark.pure_python  # another driver in place of that which the engine builds
def test_a_robot_that_a_wall_has_stopped_starts_from_rest() -> None:
    """Its setpoint came to rest faster than its wheels may: what is left of that is not driven at the next start."""
    stand = Stand("moby", slow_wheels)
    stand.drive(Twist(1.2, 0.0, 0.0), seconds=4.0)
    assert stand.setpoints == pytest.approx((12.0, 12.0, 0.0))
    stand.motors.measured = dict.fromkeys(range(3), 0.0)
    stand.run(1.5)  # as long as it might slide it is held
    assert stand.is_released()
    assert stand.reply(RequestKind.RESET) is None
    while not stand.is_in(Mode.DRIVE):
        stand.cycle(ZERO_TWIST)
        assert stand.setpoints in {(None, None, None), (0.0, 0.0, 0.0)}


@pytest.mark.pure_python  # another driver in place of that which the engine builds
def test_wheels_that_come_back_with_their_bus_go_on_from_how_they_turn() -> None:
    """Their controllers have braked them meanwhile, faster than the core may have asked for."""
    stand = Stand("moby", slow_wheels)
    stand.drive(Twist(1.2, 0.0, 0.0), seconds=4.0)
    stand.run(0.5)
    assert stand.is_in(Mode.STOPPING)
    stand.motors.states[:] = [MotorState.SILENT] * 3
    stand.cycle(bus=BusEventKind.DOWN)
    stand.run(0.1)
    stand.motors.states[:] = [MotorState.OPERATIONAL] * 3
    stand.motors.measured = dict.fromkeys(range(2), 3.0)
    stand.cycle(bus=BusEventKind.UP)
    stand.run(0.02)
    assert [speed for speed in stand.setpoints if speed is not None and speed > 3.1] == []
    assert max(speed or 0.0 for speed in stand.setpoints) > 2.0


def test_the_speeds_of_the_flip_that_would_come_are_in_its_state() -> None:
    """Pulled with an error at 1.2 m/s: sqrt(1.64) x 12 rad/s of a wheel, 4.8 of the joint; pushed there is none."""
    moments = driven(robot(compensation=False), command(0.6, 0.0, 1.2), push(3.0, 60.0), seconds=10.0)
    told = [one.outputs.status.chassis for one in moments if one.outputs.status and one.t > 2.5]
    pulled = next(facts for facts in told if facts["region"] == "pull" and facts["flip_wheel_speed"] is not None)
    assert pulled["flip_wheel_speed"] == pytest.approx(12.0 * math.sqrt(1.64), rel=0.01)
    assert pulled["flip_joint_speed"] == pytest.approx(4.8, rel=0.01)
    assert told[-1]["region"] == "push"
    assert told[-1]["flip_wheel_speed"] is None


def test_the_region_that_is_told_is_not_toggled_across_the_motion() -> None:
    """Driving across the chassis, a degree to and fro: `settled` keeps what was told."""
    law = World("moby").engine._law
    assert isinstance(law, OffsetDifferentialLaw)
    told = []
    for cycle in range(40):
        angle = math.pi / 2 + math.radians((-1.0) ** cycle)
        still = Measured(0, 0.004, (0.0,) * 3, (0.0, 0.0, angle), (None,) * 3, (0,) * 3, (0.0, 0.0, angle))
        law.motion((1.0, 0.0, 0.0), still, braking=False)
        told.append(law.facts["region"])
    assert len(set(told)) == 1
