"""The interview that writes a robot file: by script, by a person, and by somebody who types whatever comes to mind."""

import json
import sys
from collections.abc import Callable, Mapping
from io import StringIO
from math import pi
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from gateway.chassis import CHASSIS as REGISTRY
from gateway.chassis.mecanum import MecanumRobot
from gateway.chassis.odd import OddRobot
from gateway.chassis.omni import OmniRobot
from gateway.cli.app import build
from gateway.config import Motor, parse
from gateway.core.examination import examine
from gateway.setup.fields import AnswerError, Value, choice, field
from gateway.setup.interview import _CHASSIS, _CONTROLLERS, Question, robot_file
from gateway.setup.renaming import KINDS
from gateway.types import Mode, Request, RequestKind, Twist
from tests.world import World

CHASSIS: dict[str, dict[str, Value]] = {
    "omni": {"robot.wheels": 3, "robot.reach": 0.2, "robot.radius": 0.05},
    "mecanum": {"robot.wheelbase": 0.4, "robot.track": 0.36, "robot.radius": 0.0762},
    "offset_differential": {"robot.wheel_radius": 0.1, "robot.axle_offset": 0.2, "robot.track": 0.4},
    "odd": {"robot.radius": 0.0762, "robot.spacing": 0.1, "robot.narrowest": 0.25, "robot.widest": 0.6},
}
MOTOR: dict[str, Value] = {
    "motor.gear_ratio": 12,
    "motor.max_current": 20,
    "motor.max_torque": 8,
    "motor.max_speed": 30,
}
CONTROLLERS: dict[str, dict[str, Value]] = {
    "odrive-0.6": {
        **MOTOR,
        "motor.watchdog": "yes",
        "motor.options.firmware": "0.6.10",
        "motor.options.watchdog_enable_endpoint": 188,
        "motor.options.watchdog_timeout_endpoint": 189,
    },
    "odrive-0.5": MOTOR,
    "c620": {},
    "c610": {},
    "gm6020": {},
    "vesc": {**MOTOR, "motor.options.pole_pairs": 7, "motor.options.min_erpm": 100},
}
CASES = [(chassis, controller) for chassis in CHASSIS for controller in CONTROLLERS]


def answers_of(chassis: str, controller: str) -> dict[str, Value]:
    kinds: dict[str, Value] = {"robot.kind": chassis, "motor.controller": controller}
    # The heaviest that an M2006 carries is light.
    mass = 5.0 if controller in ("c610", "gm6020") else 20.0
    return {**kinds, "robot.name": "ours", "robot.body.mass": mass, **CHASSIS[chassis], **CONTROLLERS[controller]}


def asking(answers: Mapping[str, Value]) -> Callable[[Question], Value]:
    def ask(question: Question) -> Value:
        given = answers.get(question.key, question.default)
        assert given is not None, question
        return question.field.value(given)

    return ask


@pytest.mark.parametrize(("chassis", "controller"), CASES)
def test_every_chassis_with_every_controller_is_a_robot_that_can_be_driven(chassis: str, controller: str) -> None:
    text = robot_file(asking(answers_of(chassis, controller)))
    config = parse(text, "ours")
    report = examine(config, "ours")
    assert (report.kind, report.motors) == (chassis, len(config.motor))
    assert {(motor.driver, motor.direction) for motor in config.motor} == {(_CONTROLLERS[controller].driver, 1)}
    assert text.count("#") > 10


def test_a_controller_has_one_name_in_every_step() -> None:
    assert set(_CONTROLLERS) == set(KINDS)


def test_the_tables_are_those_of_the_gateway() -> None:
    assert set(_CHASSIS) == set(CHASSIS) == set(REGISTRY)
    assert set(_CONTROLLERS) == set(CONTROLLERS)


def test_wheels_are_where_they_are_said_to_be() -> None:
    config = parse(robot_file(asking(answers_of("omni", "c620"))), "ours")
    assert isinstance(config.robot, OmniRobot)
    first, second, third = config.robot.wheel
    assert (first.x, first.y) == pytest.approx((0.1, 0.1732), abs=1e-4)  # 60 degrees
    assert (second.x, repr(second.y)) == (-0.2, "0.0")  # no rounding error for a person to wonder about
    assert third.axis_angle == pytest.approx(-1.0472, abs=1e-4)
    rectangle = parse(robot_file(asking(answers_of("mecanum", "c620"))), "ours").robot
    assert isinstance(rectangle, MecanumRobot)
    assert [(wheel.x, wheel.y, wheel.roller_angle > 0.0) for wheel in rectangle.wheel] == [
        (0.2, 0.18, False),
        (-0.2, 0.18, True),
        (-0.2, -0.18, False),
        (0.2, -0.18, True),
    ]


@pytest.mark.parametrize(("side", "first"), [("left", pi / 4), ("right", -pi / 4)])
def test_the_pairs_of_the_odd(side: str, first: float) -> None:
    """Its rollers go one way and the other in turn; it begins in the middle of its range unless told."""
    answers = answers_of("odd", "c620") | {"robot.rollers": side, "limits.width_rate": 0.15}
    config = parse(robot_file(asking(answers)), "ours")
    assert isinstance(config.robot, OddRobot)
    assert config.robot.roller_angles == (first, -first, first, -first)
    assert (config.robot.width, config.robot.width_sensor) == (0.425, None)
    assert config.limits.velocity.as_rates(config.robot.AXES)[3] == 0.15
    for key, answer, words in (("robot.narrowest", 0.05, "0.1 to 10, m"), ("robot.width", 0.7, "0.25 to 0.6, m")):
        with pytest.raises(AnswerError, match=words):
            robot_file(asking(answers | {key: answer}))


# Slow enough for every controller, and for an offset-differential robot that has to turn its chassis first.
DRIVES = (Twist(0.2, 0.0, 0.0), Twist(0.0, 0.15, 0.0), Twist(0.0, 0.0, 0.3))


@pytest.mark.parametrize("chassis", CHASSIS)
@pytest.mark.parametrize("twist", DRIVES)
def test_what_is_written_drives(chassis: str, twist: Twist) -> None:
    """On the simulated robot, whose joint stands at zero."""
    text = robot_file(asking(answers_of(chassis, "c620")))
    world = World("omni4", edit=lambda _: text)
    world.run(0.3)
    for joint in world.config.robot.kinematics().steered:
        motor = world.config.motors_in_order()[joint].name
        world.cycle(requests=[Request(RequestKind.REFERENCE, 7, world.now_ns, motor, 0.0)])
    world.start()
    world.run(2.5, twist)
    assert world.is_in(Mode.DRIVE)
    assert tuple(world.bus.robot.truth.twist) == pytest.approx(tuple(twist), abs=0.03)
    world.run(2.0)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.01


def called(*arguments: object) -> Result:
    return CliRunner().invoke(build("setup"), ["setup", "new", *map(str, arguments)])


def document(result: Result) -> dict[str, object]:
    found: dict[str, object] = json.loads(result.stdout.splitlines()[-1])
    return found


def test_by_script(tmp_path: Path) -> None:
    answers, file = tmp_path / "answers.toml", tmp_path / "ours.toml"
    lines = [f"{json.dumps(key)} = {json.dumps(value)}" for key, value in answers_of("mecanum", "c620").items()]
    answers.write_text("\n".join(lines) + "\n")
    result = called(file, "--answers", answers, "--set", "robot.name=other", "--set", "bus.channel=can3", "--json")
    assert result.exit_code == 0, result.output
    config = parse(file.read_text(), "ours")
    assert (config.robot.name, config.bus[0].channel) == ("other", "can3")
    assert document(result)["ok"]
    again = called(file, "--answers", answers, "--json")
    assert (again.exit_code, document(again)["ok"]) == (1, False)
    assert "is there already" in str(document(again)["reason"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["robot.kind=tank"], "robot.kind: 'tank': must be offset_differential or omni or mecanum or odd"),
        (["robot.kind=omni"], "robot.name: missing"),
        (["robot.kind=omni", "robot.name=Ours"], "must be lower case letters, digits, _ and -"),
        (["robot.kind=omni", "robot.name=ours", "robot.wheels=2"], "robot.wheels: 2: must be 3 to 8"),
        (["robot.kind=omni", "robot.name=ours", "robot.wheels=3", "robot.reach=nan"], "must be 0.01 to 5, m"),
        (["nonsense"], "must be KEY=VALUE"),
    ],
)
def test_a_wrong_answer_is_said_with_what_is_allowed(tmp_path: Path, options: list[str], words: str) -> None:
    file = tmp_path / "ours.toml"
    result = called(file, *(word for option in options for word in ("--set", option)))
    assert result.exit_code == 1
    assert words in " ".join(result.stderr.split())
    assert not file.exists()


def test_everything_that_is_missing_is_told_at_once(tmp_path: Path) -> None:
    kinds = ["--set", "robot.kind=omni", "--set", "robot.name=ours", "--set", "motor.controller=odrive-0.6"]
    result = called(tmp_path / "ours.toml", *kinds)
    assert result.exit_code == 1
    needed = ["robot.wheels", "robot.reach", "robot.radius", "robot.body.mass", *MOTOR]
    assert [line.partition(":")[0] for line in result.stderr.splitlines()] == needed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("chassis", CHASSIS)
def test_what_stands_in_for_an_answer_never_gets_into_a_file(tmp_path: Path, chassis: str) -> None:
    """Not even where it is one number alone."""
    answers = answers_of(chassis, "c620")
    for absent in CHASSIS[chassis]:
        given = [word for key in answers if key != absent for word in ("--set", f"{key}={answers[key]}")]
        result = called(tmp_path / "ours.toml", *given)
        assert (result.exit_code, f"{absent}: missing" in result.stderr) == (1, True), result.output
    assert list(tmp_path.iterdir()) == []


def test_an_answer_that_nobody_asked_for_is_a_mistake(tmp_path: Path) -> None:
    answers = {**answers_of("omni", "c620"), "motor.colour": "red"}
    options = [word for key, value in answers.items() for word in ("--set", f"{key}={value}")]
    result = called(tmp_path / "ours.toml", *options)
    assert result.exit_code == 1
    assert "motor.colour: nobody asked for that" in result.stderr


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def test_a_person_is_asked_again_until_it_can_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    typed = ["tank", "omni", "Ours", "ours", "two", "3", "0.2", "0.05", "", "12", "", "c620"]
    monkeypatch.setattr(sys, "stdin", Terminal("\n".join(typed) + "\n" + "\n" * 40))
    file = tmp_path / "ours.toml"
    # Not by the runner, which has a standard input of its own.
    build("setup")(["setup", "new", str(file)], standalone_mode=False)
    config = parse(file.read_text(), "ours")
    assert (config.robot.name, len(config.motor), config.robot.body.mass) == ("ours", 3, 12.0)


@pytest.mark.parametrize("folder", ["missing", "file"])
def test_where_it_cannot_be_written_nobody_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(sys, "stdin", Terminal("omni\n"))
    with pytest.raises(SystemExit, match="1"):
        build("setup")(["setup", "new", str(tmp_path / folder / "ours.toml")])
    said = capsys.readouterr().err
    assert "ours.toml: cannot be written" in said
    assert "What kind" not in said


def test_a_person_who_leaves_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("omni\n"))
    with pytest.raises(BaseException, match="1"):
        build("setup")(["setup", "new", str(tmp_path / "ours.toml")], standalone_mode=True)
    assert list(tmp_path.iterdir()) == []


@given(st.text(max_size=20))
def test_whatever_is_typed_is_an_answer_or_refused_in_words(text: str) -> None:
    fields = (field(Motor, "gear_ratio"), field(Motor, "direction"), field(OmniRobot, "name"), choice(("a", "b")))
    for one in fields:
        try:
            value = one.read(text)
        except AnswerError as error:
            assert "must be" in str(error)
        else:
            assert one.value(value) == value
