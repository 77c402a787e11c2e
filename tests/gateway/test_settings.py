"""Settings of a running robot: what may be set, what is refused, and that none moves a robot by itself."""

import json
import re
from itertools import pairwise
from pathlib import Path
from random import Random

import pytest

from gateway.config import ConfigError, RobotConfig, parse
from gateway.core.assembly import build
from gateway.core.engine import Engine
from gateway.core.settings import LEAST_SHARE, LIMITING, SETTINGS, Settings, of_robot
from gateway.edges.messages import encode_setting, parse_setting
from gateway.file_keys import rules
from gateway.types import Mode, Outputs, Reply, Request, RequestKind, SettingStatus, Twist
from replay.drive.scenario_file import Scenario
from replay.inject.random_drives import SECONDS, judge, scenario
from tests.gateway.test_launch import gripping
from tests.gateway.test_offset_law import PULLED, compensated
from tests.gateway.test_snapshot import goes_on_byte_for_byte
from tests.world import BUNDLED, NAMES, World, robot_text

FAST = {"moby": Twist(0.8, 0.0, 0.0), "omni4": Twist(0.8, 0.0, 0.0)}


def ask(world: World, setting: str | None, value: float | None) -> Reply:
    request = Request(RequestKind.SET, 7, world.now_ns + world.period_ns, setting=setting, value=value)
    (reply,) = world.cycle(requests=[request]).replies
    return reply


def fastest(outputs: Outputs) -> float:
    return outputs.trace.setpoint.vx


def top(world: World) -> float:
    return world.config.limits.velocity.vx


FILE = "speed_override, linear_speed, angular_speed, acceleration_override, jerk_override"


def of_compensation() -> Settings:
    """A gain of 1 works with every region, a small region with every gain."""
    text = compensated(robot_text("moby")).replace("gain = 2.0", "gain = 1.0").replace("1.57", "0.1")
    config = parse(text, "moby")
    return Settings({}, build(config).law, config.limits.velocity)


def of_grip() -> Settings:
    config = parse(gripping(robot_text("omni4")), "omni4")
    return Settings({}, build(config).law, config.limits.velocity)


def of(settings: Settings, name: str) -> SettingStatus | None:
    return {row.name: row for row in settings.describe()}.get(name)


@pytest.mark.parametrize("setting", SETTINGS.values(), ids=lambda one: one.name)
def test_every_setting_has_a_range_and_a_default_within_it(setting: object) -> None:
    assert isinstance(setting, type(next(iter(SETTINGS.values()))))
    assert setting.low < setting.high
    assert setting.default is None or setting.refusal(setting.default) is None
    settings = next(one for one in (of_compensation(), of_grip()) if of(one, setting.name))
    row = of(settings, setting.name)
    assert row is not None
    assert setting.low <= row.low < row.high <= setting.high
    for value in (row.high, row.low):
        assert settings.set(setting.name, value) is None
        assert settings.value(setting) == value
    for value in (row.low - 1e-6, row.high + 1e-6, float("nan"), float("inf"), float("-inf")):
        words = settings.set(setting.name, value)
        assert words is not None
        assert f"{row.low:g} to {row.high:g} {setting.unit}" in words
        assert settings.value(setting) == row.low


@pytest.mark.parametrize("name", BUNDLED)
def test_what_is_shown_of_a_range_can_be_set(name: str) -> None:
    config = parse(robot_text(name), name)
    settings = Settings({}, build(config).law, config.limits.velocity)
    for row in settings.describe():
        if row.name in LIMITING:
            assert row.value == row.high
            assert settings.set(row.name, float(f"{row.low:g}")) is None
            assert settings.set(row.name, float(f"{row.high:g}")) is None


def test_what_is_refused_and_in_which_words() -> None:
    world = World("moby")
    world.run(0.1)
    assert ask(world, "speed_override", 0.5) == Reply(7, ok=True, reason=None)
    refused = ask(world, "speed_override", 2.0)
    assert refused == Reply(7, ok=False, reason="speed_override = 2: must be 0.05 to 1 of limits.velocity")
    assert ask(world, "colour", 1.0).reason == f"setting = 'colour': must be one of {FILE}"
    assert ask(world, "speed_overide", 0.5).reason == (
        f"setting = 'speed_overide': must be one of {FILE}; did you mean 'speed_override'?"
    )
    assert ask(world, None, None).reason is not None
    codes = [(event.code, event.text) for event in world.events if event.code.startswith("set")]
    assert codes[:2] == [
        ("set", "speed_override = 0.5"),
        ("set_refused", "speed_override = 2: must be 0.05 to 1 of limits.velocity"),
    ]
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    assert status.settings[0] == ("speed_override", 0.5, "of limits.velocity", 0.05, 1.0)
    assert status.settings[1:3] == (
        ("linear_speed", 1.698, "m/s", 0.0849, 1.698),
        ("angular_speed", 1.0, "rad/s", 0.05, 1.0),
    )


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("speed_override = 0.04", "settings: speed_override = 0.04: must be 0.05 to 1 of limits.velocity"),
        ("colour = 1.0", f"settings: 'colour': must be one of {FILE}, compensation_gain, compensation_region"),
        ("linear_speed = 3.0", "settings: linear_speed = 3: must be 0.0849 to 1.698 m/s"),
        ("jerk_override = nan", "settings"),
        ("compensation_gain = 2.0", "settings: compensation_gain: is said in the section of the robot that has it"),
    ],
)
def test_the_robot_file_names_what_it_is_at_the_start(lines: str, words: str) -> None:
    config = parse(f"{robot_text('moby')}\n[settings]\nspeed_override = 0.25\n", "moby")
    assert Engine(config)._settings.describe()[0].value == 0.25
    with pytest.raises(ConfigError, match=words.replace(".", r"\.")):
        build(parse(f"{robot_text('moby')}\n[settings]\n{lines}\n", "moby"))


@pytest.mark.parametrize(
    ("key", "place", "meant"),
    [
        ("limits.velocity.vx", "limits.velocity.vx", "linear_speed"),
        ("limits.velocity", "limits.velocity", "speed_override or linear_speed or angular_speed"),
        ("limits.acceleration", "limits.acceleration", "acceleration_override"),
        ("limits.jerk", "limits.jerk", "jerk_override"),
        ("robot.grip.friction", "robot.grip.friction", "friction"),
        ("motor[0].gear_ratio", "motor.gear_ratio", None),
        ("gear_ratio", "motor.gear_ratio", None),
        ("watchdog", "motor.watchdog", None),
    ],
)
def test_a_key_of_the_robot_file_needs_a_restart(key: str, place: str, meant: str | None) -> None:
    """Told in the same words to whoever encodes it, and by a robot whom somebody asks all the same."""
    words = (
        f"{key}: needs a restart: it is in the robot file ({place}), which is read at the start; settings that can be "
        f"changed while it runs: {', '.join(SETTINGS)}" + (f"; did you mean {meant}?" if meant else "")
    )
    with pytest.raises(ValueError, match=re.escape(words)):
        encode_setting(key, 1.0)
    assert parse_setting(json.dumps({"setting": key, "value": 1.0}).encode()) == words


def test_every_setting_says_which_keys_it_stands_for() -> None:
    known = {rule.key for rule in rules(RobotConfig)} | {f"limits.velocity.{axis}" for axis in ("vx", "vy", "wz")}
    for setting in SETTINGS.values():
        assert setting.keys
        assert set(setting.keys) <= known
        assert parse_setting(encode_setting(setting.name, 1.0)) == (setting.name, 1.0)


def test_the_table_of_the_readme_has_them_all() -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    table = readme.partition("| setting | range | default | what it does |\n")[2].partition("\n\n")[0]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()[1:]]
    told = {
        name: (span.strip(), default)
        for names, ranges, default, _ in cells
        for name, span in zip(re.findall(r"`(\w+)`", names), ranges.split(";"), strict=True)
    }
    assert told.keys() == SETTINGS.keys()
    for name, setting in SETTINGS.items():
        span, default = told[name]
        if name in {"linear_speed", "angular_speed"}:  # whose range is the robot's
            assert span.startswith(f"{LEAST_SHARE:.0%}".replace("%", " %"))
            continue
        assert span.removesuffix(f" {setting.unit}") == f"{setting.low:g} to {setting.high:g}"
        assert default.startswith("`[robot.") if setting.default is None else default == f"{setting.default:g}"


@pytest.mark.parametrize("name", NAMES)
def test_the_override_is_bumpless_both_ways(name: str) -> None:
    """Half of top speed is reached at no more than the limit of acceleration, and left so again."""
    world = World(name)
    world.start()
    share = Twist(top(world), 0.0, 0.0)
    world.run(3.0, share)
    assert fastest(world.last) == pytest.approx(top(world))
    acceleration = world.config.limits.acceleration.vx
    for value in (0.5, 1.0, 0.05):
        assert ask(world, "speed_override", value).ok
        begin = len(world.records)
        world.run(3.0, share)
        speeds = [fastest(outputs) for _, outputs in world.records[begin - 2 :]]
        steps = [abs(after - before) for before, after in pairwise(speeds)]
        assert speeds[-1] == pytest.approx(value * top(world))
        assert max(steps) <= acceleration * world.period_ns * 1e-9 * (1 + 1e-9)
        overridden = world.records[-1][1]
        assert overridden.mode is Mode.DRIVE
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    assert "speed_override" in status.limits_active


@pytest.mark.parametrize("name", NAMES)
def test_the_direction_is_kept(name: str) -> None:
    world = World(name)
    world.start()
    ask(world, "speed_override", 0.1)
    velocity = world.config.limits.velocity
    world.run(3.0, Twist(velocity.vx, 0.5 * velocity.vy, 0.0))
    vx, vy, wz = world.last.trace.setpoint
    assert (vx, vy, wz) == pytest.approx((0.1 * velocity.vx, 0.05 * velocity.vy, 0.0))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("twist", [None, Twist(0.0, 0.0, 0.0)])
def test_no_setting_moves_a_robot_by_itself(name: str, twist: Twist | None) -> None:
    world = World(name)
    world.start()
    for value in (0.05, 1.0, 0.3):
        ask(world, "speed_override", value)
        world.run(0.3, twist)
        assert world.last.trace.setpoint == (0.0, 0.0, 0.0)
        assert world.true_speed() < 1e-3


def test_it_can_be_set_in_an_emergency_stop_and_arms_nothing() -> None:
    world = World("moby")
    world.start()
    world.request(RequestKind.ESTOP)
    mode = world.last.mode
    assert ask(world, "speed_override", 0.5).ok
    assert world.last.mode is mode
    assert ask(world, "speed_override", 1.0).ok
    world.run(0.5, Twist(0.3, 0.0, 0.0))
    assert world.is_in(Mode.ESTOP)


def test_a_restart_goes_back_to_the_robot_file() -> None:
    world = World("moby")
    world.run(0.1)
    ask(world, "speed_override", 0.5)
    world.loop.restart(world.now_ns + 1_000_000_000)
    world.run(0.2)
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    assert status.settings[0].value == 1.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [301, 302, 303])
def test_the_laws_of_a_drive_hold_however_it_is_set(name: str, seed: int) -> None:
    config = parse(robot_text(name), name)
    script = scenario(seed, config, can_brake=True).model_dump(by_alias=True, exclude_none=True, mode="json")
    chance = Random(seed)
    rows = [row for row in of_robot(config.limits.velocity).values() if row.name in LIMITING]
    script["at"] += [
        {"t": chance.uniform(0.0, SECONDS), "set": {row.name: chance.uniform(row.low, row.high)}}
        for row in rows
        for _ in range(10)
    ]
    driven = judge(Scenario.model_validate(script), config, can_brake=True)
    assert driven.cycles > 1000
    assert not any(driven.violations.values())


@pytest.mark.parametrize("name", NAMES)
def test_it_is_in_the_snapshot(name: str) -> None:
    world = World(name)
    world.start()
    ask(world, "speed_override", 0.2)
    world.run(0.5, FAST[name])
    assert goes_on_byte_for_byte(world.records, world.config, every=5) > 30


def pulled_world() -> World:
    world = World("moby", edit=compensated, joint_angles=PULLED)
    world.start()
    world.run(2.0, Twist(0.0, 1.0, 0.0))
    return world


def test_gain_and_region_of_the_compensation_are_set_while_it_drives() -> None:
    """A gain of 1 freezes an error, 0 lets the chassis flip; the wheels are told no step of it."""
    world = pulled_world()
    assert [setting.name for setting in world.engine._settings.describe()] == [
        *(*FILE.split(", "), "compensation_gain", "compensation_region")
    ]
    assert ask(world, "compensation_gain", 0.0).ok
    before = world.last.trace.wheel_setpoints
    for _ in range(1500):
        world.cycle(commands=[world.command(Twist(0.1, 1.0, 0.0))])
        now = world.last.trace.wheel_setpoints
        assert all(abs((a or 0.0) - (b or 0.0)) < 0.5 for a, b in zip(before, now, strict=True))
        before = now
    assert abs(world.last.trace.chassis[0] or 0.0) < 0.1  # pushed


def test_what_does_not_go_together_is_refused_and_stays_as_it_was() -> None:
    refused = (
        "region = {:g}: allowed up to 0.7854 rad with gain = 3, pi/(2 (gain - 1)); "
        "beyond it the correction gets weaker again"
    )
    world = pulled_world()
    assert ask(world, "compensation_gain", 3.0).reason == refused.format(1.57)
    assert ask(world, "compensation_region", 0.7).ok
    assert ask(world, "compensation_gain", 3.0).ok
    assert ask(world, "compensation_region", 0.8).reason == refused.format(0.8)
    law = world.engine._law
    assert dict(law.settings) == {"compensation_gain": 3.0, "compensation_region": 0.7}


def test_a_robot_without_compensation_has_no_such_settings() -> None:
    for name in NAMES:
        world = World(name)
        world.run(0.1)
        assert ask(world, "compensation_gain", 2.0).reason == (f"setting = 'compensation_gain': must be one of {FILE}")


def test_a_drive_with_changed_gains_goes_on_from_a_snapshot_byte_for_byte() -> None:
    world = pulled_world()
    assert ask(world, "compensation_gain", 1.5).ok
    world.run(1.0, Twist(0.3, 0.9, 0.4))
    assert goes_on_byte_for_byte(world.records, world.config) > 2


def test_the_rate_of_a_path_that_the_commander_tells_is_taken() -> None:
    """On a circle of 0.5 m: gamma_goal = pi - asin(d1 omega/c) with omega as told, 30 degrees from straight."""
    world = pulled_world()
    told = world.command(Twist(0.0, 1.0, 0.0))._replace(path_rate=2.0)
    world.cycle(commands=[told])
    assert world.last.trace.chassis[1] == pytest.approx(3.14159265 - 0.52359878, abs=0.02)
    world.cycle(commands=[world.command(Twist(0.0, 1.0, 0.0))])
    assert world.last.trace.chassis[1] == pytest.approx(3.14159265, abs=0.02)
