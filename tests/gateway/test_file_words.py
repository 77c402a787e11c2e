"""What is said of a robot file: every problem at once, each with its range and what may have been meant."""

# ruff: noqa: E501  # what is said is given word by word

import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
from pydantic import BaseModel
from typer.testing import CliRunner

from gateway.chassis import CHASSIS
from gateway.cli.app import build
from gateway.config import ConfigError, RobotConfig, parse
from gateway.core.examination import examine_text
from gateway.file_keys import rules
from tests.world import BUNDLED, robot_text

RULES = list(rules(RobotConfig))
Edit = tuple[str, str]

# (what is typed for what, what is said)
TYPED: list[tuple[Edit, str]] = [
    (("gear_ratio = 50.0", "gear_ratio = -50"), "motor[0].gear_ratio = -50: must be a number, 0.01 to 1000 motor turns per output turn"),
    (("gear_ratio = 50.0", 'gear_ratio = "fifty"'), "motor[0].gear_ratio = 'fifty': must be a number, 0.01 to 1000 motor turns per output turn"),
    (("gear_ratio = 50.0\n", ""), "motor[0].gear_ratio: missing: a number, 0.01 to 1000 motor turns per output turn"),
    (("mass = 131.09", "mass = 0.0"), "robot.body.mass = 0.0: must be a number, above 0.1 to 5000 kg"),
    (("left = 22.0", "left = 0.0"), "limits.motor_speed.left = 0.0: must be a number, 0.001 to 10000 rad/s"),
    (("left = 22.0", "Left = 22.0"), "limits.motor_speed.Left = 'Left': must be lower case letters, digits, _ and -, a letter first, at most 32 of them"),
    (("track = 0.40", "trak = 0.40"), "robot.trak = 0.4: unknown key; did you mean 'track'?"),
    (("[recording]", "[recordings]"), "recordings: unknown key; did you mean 'recording'?"),
    (('encoder = "absolute"', 'encoder = "absolut"'), "motor[2].encoder = 'absolut': must be \"absolute\" or \"incremental\"; did you mean 'absolute'?"),
    (('kind = "offset_differential"', 'kind = "offset_diferential"'), "robot.kind = 'offset_diferential': must be one of omni, mecanum, odd, offset_differential; did you mean 'offset_differential'?"),
    (('kind = "offset_differential"\n', ""), "robot.kind: missing: one of omni, mecanum, odd, offset_differential"),
    (('driver = "odrive"', 'driver = "odrvie"'), "motor left: driver = 'odrvie': unknown; there is dji, odrive, vesc; did you mean 'odrive'?"),
    (('variant = "0.6"', 'variant = "0.8"'), "motor left: variant = '0.8': driver odrive knows 0.5, 0.6; did you mean '0.6'?"),
    (('bus = "can0"', 'bus = "cann0"'), "motor left: bus = 'cann0': no such [[bus]]; there is can0; did you mean 'can0'?"),
    (('channel = "can0"', 'channel = "can 0"'), "bus[0]: channel = 'can 0': must be the name of a network interface: at most 15 characters, no blank, / or colon: can0"),
    (('channel = "can0"', 'channel = "can0_of_the_left"'), "bus[0]: channel = 'can0_of_the_left': must be the name of a network interface: at most 15 characters, no blank, / or colon: can0"),
    (("left = \"left\"", "left = \"lefd\""), "robot: 'lefd' is no [[motor]]; did you mean 'left'?"),
    (("[zenoh]", "[settings]\nspeed_overide = 0.5\n[zenoh]"), "settings: 'speed_overide': must be one of speed_override, linear_speed, angular_speed, acceleration_override, jerk_override, compensation_gain, compensation_region, friction; did you mean 'speed_override'?"),
    (("bitrate = 1_000_000", "bitrate = 1_000"), "bus[0].bitrate = 1000: must be a whole number, 10000 to 1000000 bit/s"),
    (("rate = 250.0", "rate = true"), "loop.rate = True: must be a number, 10 to 1000 Hz"),
    (('watchdog = { timeout = 0.1 }', 'watchdog_waiver = "none"'), "motor[0].watchdog_waiver = 'none': must be a text of 20 to 300 characters"),
]  # fmt: skip


def edited(*edits: Edit) -> str:
    text = robot_text("moby") + '\n[recording]\ndirectory = "sessions"\n'
    for right, wrong in edits:
        assert right in text, right
        text = text.replace(right, wrong, 1)
    return text


def problems(text: str) -> Sequence[str]:
    with pytest.raises(ConfigError) as caught:
        examine_text(text, "r.toml")
    assert all(line.startswith("r.toml: ") for line in str(caught.value).splitlines())
    return caught.value.problems


@pytest.mark.parametrize(("edit", "said"), TYPED, ids=[said.partition(":")[0] for _, said in TYPED])
def test_what_is_said_of_one_mistake(edit: Edit, said: str) -> None:
    assert said in problems(edited(edit))


def test_every_layer_is_told_at_once() -> None:
    """Of the fields, of what fits together, of the drivers and of the examination: none hides another."""
    found = problems(
        edited(
            ("axle_offset = 0.25", "axle_ofset = 0.25"),
            ('driver = "odrive"', 'driver = "odrvie"'),
            ("priority = 10,", "priority = 100,"),
            ("timeout = 0.1 }\noptions", "timeout = 0.001 }\noptions"),
            ("acceleration = { vx = 0.8", "acceleration = { vx = 0.08"),
            ("[zenoh]", "[settings]\nspeed_override = 3.0\n[zenoh]"),
        ).replace("id = 2\n", "id = 63\n")
    )
    for words in (
        "robot.axle_offset: missing",
        "robot.axle_ofset = 0.25: unknown key",
        "commands.source.priority = 100: given twice",
        "motor left: driver = 'odrvie': unknown",
        "motor right: id = 63: must be 0 to 62",
        "settings: speed_override = 3: must be 0.05 to 1",
        "limits: a stop from top speed takes 22.0 s",
    ):
        assert any(problem.startswith(words) for problem in found), (words, found)
    assert len(found) == len(set(found))


def test_of_two_wrong_motors_of_one_driver_both_are_named() -> None:
    text = edited().replace("feedback_rate = 250.0", "feedback_rate = 1.0")
    found = problems(text)
    assert [problem.partition(":")[0] for problem in found] == ["motor left", "motor right", "motor platform"]
    twice = problems(edited(("id = 2\n", "id = 1\n")))
    assert len(twice) == 1
    assert "right" in twice[0]


def test_a_table_that_is_wrong_is_not_judged_further() -> None:
    """Nothing follows from a number that nobody knows: what is told is wrong by itself."""
    found = problems(edited(("gear_ratio = 50.0", "gear_ratio = 0.0"), ("[limits]", "[limit]")))
    assert [problem.partition(":")[0] for problem in found] == ["limits", "motor[0].gear_ratio = 0.0", "limit"]


@pytest.mark.parametrize("name", BUNDLED)
def test_a_sound_file_has_no_problem(name: str) -> None:
    config, report = examine_text(robot_text(name), name)
    assert config == parse(robot_text(name), name)
    assert report.robot == config.robot.name


# the keys


def sections(model: type[BaseModel], seen: set[type[BaseModel]]) -> set[type[BaseModel]]:
    for field in model.model_fields.values():
        for name in re.findall(r"[\w.]+", str(field.annotation)):
            module, _, last = name.rpartition(".")
            found = getattr(__import__(module, fromlist=[last]), last, None) if module.startswith("gateway.") else None
            if isinstance(found, type) and issubclass(found, BaseModel) and found not in seen:
                sections(found, seen | {found})
                seen |= {found, *sections(found, seen)}
    return seen


def test_every_key_of_every_section_is_there_and_has_a_meaning() -> None:
    assert [rule.key for rule in RULES if not rule.meaning] == []
    last = {rule.key.rpartition(".")[2] for rule in RULES}
    found = sections(RobotConfig, set())
    assert len(found) > 20
    for section in found:
        assert set(section.model_fields) <= last, section
    assert {rule.chassis for rule in RULES} == {None, *CHASSIS}


UNITS = {"rad", "m", "s", "A", "V", "N m", "kg", "Hz", "ohm", "bit/s", "bytes", "rad/s", "rad/s^2", "m/s", "kg m^2"}


def test_every_number_has_a_unit_or_none_to_have() -> None:
    bare = {
        rule.key
        for rule in RULES
        if rule.unit is None and rule.allowed.startswith(("a number", "a whole number")) and "limits." not in rule.key
    }
    assert bare == {
        *("robot.steering.yaw_rate", "robot.balance.velocity", "robot.compensation.gain"),
        *("motor.id", "sensor.id", "commands.source.priority"),
    }
    assert {rule.unit for rule in RULES} >= UNITS


def invoked(command: str, *arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(build(command), [command, *arguments])
    return done.exit_code, done.output


EXPLAINED = [
    ("limits.motor_speed", ["limits.motor_speed", "0.001 to 10000 rad/s; required", "of each motor's output"]),
    ("limits.motor_speed.left", ["limits.motor_speed"]),
    ("motor[2].gear_ratio", ["motor.gear_ratio", "0.01 to 1000 motor turns per output turn; required"]),
    ("gear_ratio", ["motor.gear_ratio"]),
    ("motor.driver", ["there is odrive; "]),
    ("loop.rate", ["10 to 1000 Hz; default 250.0"]),
    ("robot.track", ["robot.track (of offset_differential)", "0.001 to 10 m"]),
    ("robot.grip", ["robot.grip.friction (of omni)"]),
    ("fault_stall", ["likely causes"]),
]


@pytest.mark.parametrize(("word", "shown"), EXPLAINED)
def test_explain(word: str, shown: list[str]) -> None:
    exit_code, output = invoked("explain", word)
    assert exit_code == 0
    assert all(line in output for line in shown), output


@pytest.mark.parametrize(
    ("word", "meant"),
    [("limits.motr_speed", "limits.motor_speed"), ("gear_rato", "gear_ratio"), ("fault_stal", "fault_stall")],
)
def test_explain_what_is_nothing(word: str, meant: str) -> None:
    exit_code, output = invoked("explain", word)
    assert exit_code == 1
    assert f"did you mean '{meant}'?" in output


def test_the_whole_format() -> None:
    _, output = invoked("format")
    assert all(rule.key in output and rule.allowed in output for rule in RULES)
    _, output = invoked("format", "--json")
    told = json.loads(output)["keys"]
    assert len(told) == len(RULES)
    track = next(one for one in told if one["key"] == "robot.track")
    assert track == {
        "key": "robot.track",
        "chassis": "offset_differential",
        "meaning": "between the driven wheels (d2)",
        "unit": "m",
        "allowed": "a number, 0.001 to 10 m",
        "default": None,
        "table": False,
        "required": True,
    }
    _, output = invoked("format", "--chassis", "omni", "--json")
    assert {one["chassis"] for one in json.loads(output)["keys"]} == {None, "omni"}
    exit_code, output = invoked("format", "--chassis", "omnii")
    assert exit_code == 78
    assert "did you mean 'omni'?" in output


def test_check_says_which_file_and_all_of_its_problems(tmp_path: Path) -> None:
    wrong = tmp_path / "moby.toml"
    wrong.write_text(edited(("track = 0.40", "trak = 0.40"), ('driver = "odrive"', 'driver = "odrvie"')))
    exit_code, output = invoked("check", str(wrong), "--json")
    assert exit_code == 78
    told = json.loads(output)
    assert told["valid"] is False
    assert told["file"] == str(wrong)
    assert len(told["problems"]) == 3
    exit_code, output = invoked("check", "moby")
    assert exit_code == 0
    assert "moby.toml (bundled)" in output.replace("\n", "")
    other = tmp_path / "porter.toml"
    other.write_text(robot_text("moby"))
    _, output = invoked("check", str(other), "--json")
    told = json.loads(output)
    assert told["file"] == str(other)
    assert any(warning.startswith("robot.name = 'moby' is not the name of its file") for warning in told["warnings"])


def test_a_rule_is_of_one_key() -> None:
    assert len({(rule.key, rule.chassis) for rule in RULES}) == len(RULES)
