"""`drivegate setup calibrate` and `covariance` of courses driven earlier: nothing moves, what is written is true."""

import json
import tomllib
from datetime import date
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.cli import output
from gateway.cli.app import build
from gateway.cli.setup_courses import keep_course, write
from gateway.cli.setup_covariance import words
from gateway.config import ConfigError, load, parse
from gateway.setup.correction import Entry
from gateway.setup.courses import CourseError, CourseName, Courses, courses_text, read_courses
from replay.calibrate.likelihood import Consistency
from replay.sim.plants import plant_of
from tests.replay.measured_courses import drive_courses
from tests.setup_robots import TRUE
from tests.world import robot_text

PLAN = (CourseName.FORWARD, CourseName.LEFT, CourseName.BACKWARD, CourseName.RIGHT)
TRUTH = {"wheel_radius": 0.082, "axle_offset": 0.19, "track": 0.36}


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines as long as they are."""
    monkeypatch.setattr(output.console, "_width", 300)


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Courses:
    """A robot that is not as its file says, driven and measured."""
    robot = parse(TRUE["mobyish"](), "mobyish").robot
    assert isinstance(robot, OffsetDifferentialRobot)
    plant = plant_of(robot.model_copy(update=TRUTH))
    return drive_courses(tmp_path_factory.mktemp("driven"), TRUE["mobyish"](), PLAN, plant, length=0.8)


class Bench:
    """A robot file and a file of courses, in a folder of their own."""

    def __init__(self, folder: Path, courses: Courses) -> None:
        self.file, self.courses = folder / "robot.toml", folder / "courses.toml"
        self.file.write_text(TRUE["mobyish"]())
        self.courses.write_text(courses_text(courses))

    def call(self, command: str, *more: str, answers: str = "") -> Result:
        arguments = ["setup", command, str(self.file), "--measured", str(self.courses), *more]
        return CliRunner().invoke(build("setup"), arguments, input=answers)

    def refused(self, command: str, *more: str) -> str:
        before = self.file.read_text()
        result = self.call(command, "--json", *more)
        assert result.exit_code == 1
        assert self.file.read_text() == before
        told = document(result)
        assert told["ok"] is False
        return str(told["reason"])


def document(result: Result) -> dict[str, object]:
    found: dict[str, object] = json.loads(result.stdout)
    return found


@pytest.fixture
def bench(tmp_path: Path, driven: Courses) -> Bench:
    return Bench(tmp_path, driven)


def test_the_file_becomes_the_true_one(bench: Bench) -> None:
    before = bench.file.read_text()
    result = bench.call("calibrate", "--yes", "--json")
    assert result.exit_code == 0, result.output
    told = document(result)
    robot = tomllib.loads(bench.file.read_text())["robot"]
    numbers = told["numbers"]
    assert isinstance(numbers, list)
    assert [one["name"] for one in numbers] == list(TRUTH)
    for one in numbers:
        assert one["low"] < TRUTH[one["name"]] < one["high"]
        assert robot[one["name"]] == pytest.approx(one["value"], abs=0.01 * (one["high"] - one["low"]))
        assert one["old"] == tomllib.loads(before)["robot"][one["name"]]
    load(bench.file)
    assert Path(str(told["kept"])).read_text() == before
    today = date.today().isoformat()  # noqa: DTZ011
    lines = [line for line in bench.file.read_text().splitlines() if "(95 %), 4 courses" in line]
    assert len(lines) == 3
    assert all(f"# m, {today}: {line.split(' ')[0]} " in line for line in lines)
    again = bench.call("calibrate", "--yes", "--json")
    assert again.exit_code == 0
    after = document(again)["numbers"]
    assert isinstance(after, list)
    # Once it is so, it stays so, within what is rounded off.
    for one, other in zip(numbers, after, strict=True):
        assert other["value"] == pytest.approx(one["value"], abs=0.02 * (one["high"] - one["low"]))


def test_people_are_told_and_asked(bench: Bench) -> None:
    before = bench.file.read_text()
    result = bench.call("calibrate")
    assert result.exit_code == 1
    assert "a person has to let it happen" in result.stderr
    assert "-track = 0.35" in result.stderr
    assert "no key says it" in result.stdout
    assert bench.file.read_text() == before
    assert list(bench.file.parent.glob("*.before*")) == []


def test_a_session_given_aside(bench: Bench, driven: Courses) -> None:
    nameless = driven.model_copy(update={"course": [one.model_copy(update={"session": None}) for one in driven.course]})
    bench.courses.write_text(courses_text(nameless))
    assert bench.refused("calibrate") == "course.0: no session: name it there, or give --session"
    assert bench.call("calibrate", "--yes", "--session", str(driven.course[0].session)).exit_code == 0


def changed(courses: Courses, **what: object) -> Courses:
    return courses.model_copy(update={"course": [one.model_copy(update=what) for one in courses.course]})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"session": "nowhere"}, "nowhere: cannot be read"),
        ({"end": 10**6}, "is not in the recording"),
        ({"x": 5.0}, "fit"),
    ],
)
def test_refusals(bench: Bench, driven: Courses, change: dict[str, object], said: str) -> None:
    bench.courses.write_text(courses_text(changed(driven, **change)))
    assert said in bench.refused("calibrate")


def test_courses_of_which_nothing_was_measured(bench: Bench, driven: Courses) -> None:
    bench.courses.write_text(courses_text(changed(driven, x=None, y=None, turn=None)))
    result = bench.call("calibrate")
    assert isinstance(result.exception, ConfigError)  # which ends the program with 78
    assert "course.3 (right): nothing measured: give x, y (m) and turn (rad)" in str(result.exception)


def test_a_session_without_what_was_measured(tmp_path: Path, driven: Courses) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(TRUE["mobyish"]())
    arguments = ["setup", "calibrate", str(file), "--session", str(driven.course[0].session)]
    result = CliRunner().invoke(build("setup"), arguments)
    assert result.exit_code == 1
    assert "--session needs --measured" in result.stderr


def test_where_courses_cannot_be_kept_nothing_is_driven(bench: Bench) -> None:
    nowhere = bench.file.parent / "nowhere" / "courses.toml"
    result = CliRunner().invoke(build("setup"), ["setup", "calibrate", str(bench.file), "--out", str(nowhere), "--yes"])
    assert result.exit_code == 1
    assert f"{nowhere}: No such file or directory" in result.stderr


def test_a_link_to_courses_that_are_still_to_come_stays(bench: Bench) -> None:
    link = bench.file.with_name("link.toml")
    link.symlink_to(bench.file.with_name("to_come.toml"))
    nobody = ["--connect", "tcp/127.0.0.1:1", "--out", str(link), "--yes"]
    assert CliRunner().invoke(build("setup"), ["setup", "calibrate", str(bench.file), *nobody]).exit_code != 0
    assert link.is_symlink()
    assert not link.exists()


def test_a_course_is_added_to_what_was_written_meanwhile(tmp_path: Path, driven: Courses) -> None:
    config, place = parse(TRUE["mobyish"](), "mobyish"), tmp_path / "courses.toml"
    first, second = driven.course[:2]
    keep_course(place, config, first)
    place.write_text(place.read_text().replace("tape = 0.003", "tape = 0.001  # with a laser;"))
    keep_course(place, config, second)
    assert read_courses(place.read_text(), "courses", config) == Courses(
        robot=driven.robot, tape=0.001, course=[first, second]
    )
    assert "# with a laser;" in place.read_text()


def test_no_more_courses_are_driven_than_a_file_has(bench: Bench, driven: Courses) -> None:
    many = driven.model_copy(update={"course": list(driven.course) * 125})
    bench.courses.write_text(courses_text(many))
    more = ["--out", str(bench.courses), "--repeat", "1", "--course", "forward", "--yes"]
    result = CliRunner().invoke(build("setup"), ["setup", "calibrate", str(bench.file), *more])
    assert (result.exit_code, "more than 500" in result.stderr) == (1, True)


def test_metres_taken_for_centimetres(bench: Bench, driven: Courses) -> None:
    far = [one.model_copy(update={"x": 100.0 * (one.x or 0.0), "y": 100.0 * (one.y or 0.0)}) for one in driven.course]
    bench.courses.write_text(courses_text(driven.model_copy(update={"course": far})))
    assert "no geometry near" in bench.refused("calibrate")


def test_what_would_not_drive_is_not_written(bench: Bench) -> None:
    """A file that can be read, and a robot that nobody can drive: its loop is slower than its watchdogs."""
    text = bench.file.read_text()
    with pytest.raises(CourseError, match="with what was found the robot could not be driven"):
        write(bench.file, text, [Entry(("loop", "rate"), 10.0, "Hz")], yes=True)
    assert bench.file.read_text() == text


def test_covariance_needs_more_courses(bench: Bench) -> None:
    assert bench.refused("covariance", "--yes").startswith("4 courses: 16 more at least")


def test_covariance_is_written(bench: Bench, driven: Courses) -> None:
    """The same few courses over and over, each time measured elsewhere: what is written is what was found."""
    assert tomllib.loads(bench.file.read_text()).get("odometry") is None
    robot = parse(TRUE["mobyish"](), "mobyish")
    true = robot.robot.model_copy(update=TRUTH)
    bench.file.write_text(
        "\n".join(
            f"{line.split(' = ')[0]} = {TRUTH[line.split(' = ')[0]]}" if line.split(" = ")[0] in TRUTH else line
            for line in bench.file.read_text().splitlines()
        )
    )
    assert load(bench.file)[0].robot.model_dump() == true.model_dump()
    off = [(-0.02, 0.015), (0.018, 0.02), (0.02, -0.017), (-0.015, -0.02), (0.001, 0.004), (0.002, -0.003)] * 2
    many = [
        one.model_copy(update={"x": (one.x or 0.0) + x, "y": (one.y or 0.0) + y})
        for x, y in off
        for one in driven.course
    ]
    bench.courses.write_text(courses_text(driven.model_copy(update={"course": many})))
    result = bench.call("covariance", "--yes", "--json")
    assert result.exit_code == 1, result.output  # nothing of it turned
    told = document(result)
    written = tomllib.loads(bench.file.read_text())["odometry"]
    growths = told["growths"]
    assert isinstance(growths, list)
    assert {one["key"]: float(f"{one['value']:.3g}") for one in growths} == written
    # 2 cm to 2.6 cm off after 0.8 m, some of it by tape
    assert 1e-4 < written["variance_per_metre"] < 6e-4
    untold = told["untold"]
    assert isinstance(untold, list)
    assert "heading_variance_per_radian" in {one["key"] for one in untold}
    assert "(95 %), 48 courses" in bench.file.read_text()


@pytest.mark.parametrize(
    ("nees", "said"), [(2.0, "too cautious"), (3.0, "consistent"), (5.0, "the covariance is too sure of itself")]
)
def test_whether_the_covariance_is_right_in_words(nees: float, said: str) -> None:
    assert words(Consistency(nees, 3.0, 2.3, 3.7)).endswith(said)


def test_other_chassis_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "odd.toml"
    file.write_text(robot_text("odd"))
    for command in ("calibrate", "covariance"):
        result = CliRunner().invoke(build("setup"), ["setup", command, str(file), "--yes"])
        assert result.exit_code == 1
        assert "kind odd: measured courses are for" in result.stderr
