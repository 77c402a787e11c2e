"""`drivegate check` says everything at once: what is wrong, of every layer, and what the robot can do."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.config import ConfigError, parse
from gateway.core.assembly import assemble
from gateway.core.assembly import build as robot_of
from gateway.core.examination import examine, examined
from gateway.kinematics.linear import Matrix
from tests.world import BUNDLED, robot_text


def check(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(build("check"), ["check", *map(str, arguments)])
    return done.exit_code, done.stdout, " ".join(done.stderr.replace("│", "").split())


def edited(robot: str, *edits: tuple[str, str]) -> str:
    text = robot_text(robot)
    for pattern, new in edits:
        text, times = re.subn(pattern, new, text, flags=re.MULTILINE)
        assert times, pattern
    return text


SLOW = (r"^acceleration = \{ vx = [\d.]+", "acceleration = { vx = 0.1")  # a stop takes too long
WILD = (r"kp = [\d.]+", "kp = 50.0")  # the speed loop swings
NARROW = ("bitrate = 1_000_000", "bitrate = 250_000")  # of the bus
TIPPING = ("^x = 0.10$", "x = 0.30"), ("^x = -0.10$", "x = 0.25")  # the middle is behind all wheels
GRIP = (r"^\[robot.body\]", "[robot.grip]\nfriction = 0.5\n\n[robot.body]")
FAST = (r"velocity = \{ vx = [\d.]+", "velocity = { vx = 3.4")  # the wheels cannot outrun it to catch it

# What the drive law refuses, and beside it what the examination does. Every line is one that `check` says alone, too.
AT_ONCE = {
    "grip": ("omni4", (*TIPPING, GRIP), "robot.grip: wheel"),
    "balance": ("odd_balancing", (FAST,), "robot.balance: limits.velocity.vx = 3.4"),
    "category": ("omni4", ((r"^\[loop\]", "[stop]\ncategory = 0\n\n[loop]"),), "stop.category = 0: must be 1 or 2"),
}
BEHIND = {"limits: a stop from top speed takes": SLOW, "speed_loop.kp = 50: takes back": WILD, "bus can0: load": NARROW}


@pytest.mark.parametrize("refused", AT_ONCE)
def test_the_examination_is_told_beside_what_the_drive_law_refuses(refused: str, tmp_path: Path) -> None:
    robot, edits, law_says = AT_ONCE[refused]
    text = edited(robot, *edits, *BEHIND.values())
    told = examined(text, "r").problems
    for words in (law_says, *BEHIND):
        assert any(words in problem for problem in told), (words, told)
    assert len(told) == len(set(told))
    file = tmp_path / f"{robot}.toml"
    file.write_text(text)
    exit_code, shown, complained = check(file)
    assert exit_code == 78
    assert law_says in complained
    assert all(words in complained for words in BEHIND)
    assert "top speed vx" in shown, "and what can be said of it all the same"
    _, shown, _ = check(file, "--json")
    document = json.loads(shown)
    assert document["valid"] is False
    assert document["problems"] == list(told)
    assert document["stopping_time_s"] > 5.0


@pytest.mark.parametrize("refused", AT_ONCE)
def test_nothing_is_driven_with_what_its_law_refuses(refused: str) -> None:
    """The plain law in its place is for looking at it alone."""
    robot, edits, law_says = AT_ONCE[refused]
    config = parse(edited(robot, *edits), "r")
    looked = assemble(config)
    assert looked.robot is not None
    assert len(looked.problems) == 1
    for refusing in (robot_of, examine):
        with pytest.raises(ConfigError, match=re.escape(law_says)):
            refusing(config, "r")


def test_settings_geometry_drivers_and_loops_are_told_together() -> None:
    text = edited(
        "omni4",
        (r"^axis_angle = .*$", "axis_angle = 1.0"),
        (r"^speed_loop = .*\n", ""),
        SLOW,
        (r"^\[loop\]", "[settings]\nspeed_override = 7.0\n\n[loop]"),
    )
    told = "\n".join(examined(text, "r").problems)
    for words in ("speed_override", "cannot move along the line 57", "speed_loop is missing", "a stop from top speed"):
        assert words in told


@pytest.mark.parametrize("name", BUNDLED)
def test_a_sound_robot_is_examined_as_ever(name: str) -> None:
    found = examined(robot_text(name), name)
    assert found.problems == ()
    assert found.config is not None
    assert found.report == examine(found.config, name)
    matrix: Matrix = robot_of(found.config).kinematics.matrix()
    assert len(matrix) == found.report.motors


@pytest.mark.parametrize("name", BUNDLED)
def test_signs_are_said_and_what_no_file_shows(name: str) -> None:
    exit_code, shown, _ = check(name)
    assert exit_code == 0
    said = " ".join(shown.split())
    assert "turned positively" in said
    assert f"no file shows them: `drivegate setup directions {name}`" in said
    _, shown, _ = check(name, "--json")
    document = json.loads(shown)
    assert document["valid"] is True
    config = parse(robot_text(name), name)
    assert list(document["positive"]) == list(config.robot.motor_names())


def test_a_picture_beside_the_report(tmp_path: Path) -> None:
    for ending, begins in ((".svg", b"<svg"), (".png", b"\x89PNG")):
        picture = tmp_path / f"out{ending}"
        exit_code, shown, _ = check("moby", "--json", "--picture", picture)
        assert exit_code == 0
        assert json.loads(shown)["valid"]
        assert picture.read_bytes().startswith(begins)


def test_a_picture_of_a_robot_whose_other_sections_are_wrong(tmp_path: Path) -> None:
    file, picture = tmp_path / "omni4.toml", tmp_path / "omni4.svg"
    file.write_text(edited("omni4", WILD))
    assert check(file, "--picture", picture)[0] == 78
    assert picture.exists()
    file.write_text(edited("omni4", (r"^\[limits\]", "[limit]")))
    picture.unlink()
    assert check(file, "--picture", picture)[0] == 78
    assert picture.exists()


@pytest.mark.parametrize(
    ("edits", "picture", "exit_code", "words"),
    [
        ((), "out.jpg", 2, "must end in .svg or .png"),
        ((), "missing/out.svg", 1, ": No such file or directory"),
        ((), "missing/out.png", 1, ": No such file or directory"),
        (((r"^radius = .*$", "radius = 0.0"),), "out.svg", 78, "no picture: what is wrong is in [robot]"),
        (((r"^axis_angle = .*$", "axis_angle = 0.0"),), "out.svg", 78, "no picture: these wheels cannot drive"),
    ],
)
def test_a_picture_that_cannot_be(
    edits: tuple[tuple[str, str], ...], picture: str, exit_code: int, words: str, tmp_path: Path
) -> None:
    file = tmp_path / "omni4.toml"
    file.write_text(edited("omni4", *edits))
    told, _, complained = check(file, "--picture", tmp_path / picture)
    assert told == exit_code
    assert words in complained
    assert not (tmp_path / picture).exists()
