"""Zero and direction of a steered joint, from how it is put and turned by hand, where the robot file is wrong."""

import json
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from unittest.mock import patch

import pytest
import tomlkit
import typer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.cli import setup_reference
from gateway.cli.app import build
from gateway.cli.asking import ask
from gateway.config import parse
from gateway.edges.claims import Claims, InUseError
from gateway.setup.correction import Change
from gateway.setup.reference import referenced, steered
from gateway.setup.words import zero_way
from tests.gateway.test_setup_inputs import Terminal, Told, simulated
from tests.jogging import Bench
from tests.setup_robots import TRUE
from tests.world import BUNDLED, robot_text

PLATFORM = 2  # its place
TURN_S = 0.6


def moby(zero: float, direction: int) -> str:
    document = tomlkit.parse(robot_text("moby"))
    motor = next(one for one in document["motor"] if one["name"] == "platform")
    motor["zero"], motor["direction"] = zero, direction
    return tomlkit.dumps(document)


class Person:
    """Somebody at the robot `true`, whose file is `given`. `speed`: rad/s at which he turns the joint when asked."""

    def __init__(self, directory: Path, true: str, given: str, *, speed: float = 1.5, shaking: float = 0.0) -> None:
        self.bench = Bench(parse(true, "true"))
        self.file = directory / "moby.toml"
        self.file.write_text(given)
        self.speed = speed
        self.shaking = shaking
        self.said = ""

    def answers(self, question: str) -> str:
        turned, answer = "press Enter, then turn" in question, ask(question)
        if turned and answer == "":
            self.bench.plant.turn_by_hand(PLATFORM, self.speed, TURN_S)
        elif not turned and self.shaking:
            self.bench.plant.turn_by_hand(PLATFORM, self.shaking, TURN_S)
        return answer

    def calls(
        self, *options: str, typed: Sequence[str] = ("", ""), terminal: bool = False
    ) -> tuple[int, dict[str, object]]:
        out, err, code = StringIO(), StringIO(), 1
        stdin = patch.object(sys, "stdin", Terminal(typed, terminal=terminal))
        asked = patch.object(setup_reference, "ask", self.answers)
        arguments = ["setup", "reference", str(self.file), *options, "--json"]
        with (
            simulated(self.bench, Told(), lambda _: None),
            stdin,
            asked,
            redirect_stdout(out),
            redirect_stderr(err),
            suppress(typer.Exit),
        ):
            code = build("setup")(arguments, standalone_mode=False) or 0
        assert self.bench.sent == []
        self.said = err.getvalue()
        return code, json.loads(out.getvalue())


@pytest.mark.parametrize("zero", [0.7, -1.25])
@pytest.mark.parametrize("direction", [1, -1])
def test_the_file_becomes_the_true_one(tmp_path: Path, zero: float, direction: int) -> None:
    true, given = moby(zero, direction), moby(0.0, 1)
    person = Person(tmp_path, true, given)
    code, found = person.calls("--yes")
    assert (code, found["ok"], found["joints"]) == (0, True, {"platform": "absolute"})
    assert person.file.read_text() == true
    assert Path(str(found["kept"])).read_text() == given
    person.bench.plant.by_hand[PLATFORM] = None
    person.bench.plant.place([0.0] * 3)
    person.bench.wait(0.3)
    code, again = person.calls("--yes")
    assert (code, again["changes"], again["kept"]) == (0, [], None)


def test_a_joint_that_cannot_be_turned_keeps_its_direction(tmp_path: Path) -> None:
    person = Person(tmp_path, moby(0.7, -1), moby(0.0, -1))
    code, found = person.calls("--yes", typed=("", "n"))
    assert (code, found["changes"]) == (0, [{"motor": "platform", "key": "zero", "old": 0.0, "new": 0.7}])


def test_a_turn_the_wrong_way_is_a_direction_the_wrong_way(tmp_path: Path) -> None:
    """What is said is believed: so the difference is shown."""
    person = Person(tmp_path, moby(0.0, 1), moby(0.0, 1), speed=-1.5)
    assert person.calls("--yes")[1]["changes"] == [{"motor": "platform", "key": "direction", "old": 1, "new": -1}]


def test_one_that_is_not_held_still_has_no_zero(tmp_path: Path) -> None:
    person = Person(tmp_path, moby(0.7, 1), moby(0.0, 1), shaking=0.3)
    code, found = person.calls("--yes")
    assert (code, "hold it still" in str(found["reason"])) == (1, True)
    assert person.file.read_text() == moby(0.0, 1)


def test_one_that_is_not_heard_has_no_zero(tmp_path: Path) -> None:
    person = Person(tmp_path, moby(0.7, 1), moby(0.0, 1))
    person.bench.bus.robot.devices["platform"].power_off()
    code, found = person.calls("--yes")
    assert (code, "encoder tells nothing" in str(found["reason"])) == (1, True)


@pytest.mark.parametrize("also", [False, True])
def test_another_joint_that_turns_is_not_this_one(tmp_path: Path, also: bool) -> None:
    person = Person(tmp_path, moby(0.7, 1), moby(0.0, 1), speed=1.5 if also else 0.0)
    answers = person.answers

    def with_a_wheel(question: str) -> str:
        answer = answers(question)
        if "press Enter, then turn" in question:
            person.bench.plant.turn_by_hand(0, 2.0, TURN_S)
        return answer

    person.answers = with_a_wheel  # type: ignore[method-assign]
    code, found = person.calls("--yes")
    assert (code, "turn it alone" in str(found["reason"])) == (1, True), found
    assert person.file.read_text() == moby(0.0, 1)


def test_an_incremental_encoder_is_told_what_applies(tmp_path: Path) -> None:
    text = TRUE["mobyish"]()
    person = Person(tmp_path, text, text)
    code, found = person.calls()
    assert (code, found) == (0, {"ok": True, "joints": {"platform": "incremental"}, "changes": [], "kept": None})
    assert person.file.read_text() == text
    assert "drivegate reference mobyish --motor platform" in " ".join(person.said.split())


@pytest.mark.parametrize("name", BUNDLED)
def test_what_is_steered_has_words(name: str) -> None:
    config = parse(robot_text(name), name)
    joints = steered(config)
    assert [motor.name for motor in joints] == (["platform"] if name == "moby" else [])
    assert all("wheels beneath it roll" in zero_way(config, motor.name) for motor in joints)


@pytest.mark.parametrize(
    ("stands", "way", "expected"),
    [
        (0.0, None, []),
        (0.004, 9.0, []),
        (0.3, 9.0, [Change("platform", "zero", 0.2, 0.5)]),
        (0.3, -9.0, [Change("platform", "direction", 1, -1), Change("platform", "zero", 0.2, -0.5)]),
    ],
)
def test_what_is_changed(stands: float, way: float | None, expected: list[Change]) -> None:
    (motor,) = steered(parse(moby(0.2, 1), "moby"))
    assert referenced(motor, stands, way) == expected


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture]
)
@given(typed=st.lists(st.sampled_from(["", "y", "n", "no", "yes!"]), max_size=4), terminal=st.booleans())
def test_without_a_yes_the_file_stays(tmp_path: Path, typed: list[str], terminal: bool) -> None:
    person = Person(tmp_path, moby(0.7, -1), moby(0.0, 1))
    code, found = person.calls(typed=typed, terminal=terminal)
    assert (code, found["ok"]) == (1, False)
    assert person.file.read_text() == moby(0.0, 1)


def test_a_gateway_on_the_bus_is_left_alone(tmp_path: Path) -> None:
    person = Person(tmp_path, moby(0.7, -1), moby(0.0, 1).replace('channel = "can0"', 'channel = "held_ref"'))
    claims = Claims("socketcan", "held_ref", [0x7FF])
    with pytest.raises(InUseError):
        person.calls("--yes")
    claims.release()
