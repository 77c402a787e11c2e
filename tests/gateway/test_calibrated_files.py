"""Measured courses as a file, and what was found put into a robot file: everything else as it was."""

import pytest

from gateway.config import ConfigError, parse
from gateway.setup.correction import CorrectionError, Entry, rounded, with_entries, with_options
from gateway.setup.courses import (
    GEOMETRY,
    SPEED,
    Course,
    CourseError,
    CourseName,
    Courses,
    courses_text,
    geometry_courses,
    legs,
    read_courses,
    unmeasured,
    with_course,
)
from gateway.types import CHOSEN_GROWTH
from tests.setup_robots import TRUE
from tests.world import BUNDLED, robot_text

COURSES = Courses(
    robot="kiwi",
    course=[
        Course(course=CourseName.FORWARD, session="sessions/kiwi-1", begin=10, end=20, x=2.01, y=-0.02, turn=0.01),
        Course(course=CourseName.TURN_LEFT, begin=30, end=40, turn=3.1),
        Course(course=CourseName.LEFT, begin=50, end=60),
    ],
)


def test_courses_come_back_from_their_text() -> None:
    config = parse(TRUE["kiwi"](), "kiwi")
    assert read_courses(courses_text(COURSES), "courses.toml", config) == COURSES
    assert unmeasured(COURSES) == ["course.2 (left): nothing measured: give x, y (m) and turn (rad)"]


@pytest.mark.parametrize("inline", [False, True])
def test_one_more_course_leaves_what_a_person_wrote(inline: bool) -> None:
    config, more = parse(TRUE["kiwi"](), "kiwi"), Course(course=CourseName.RIGHT, begin=70, end=80, turn=0.1)
    text = courses_text(COURSES).replace("x = 2.01", "x = 2.02  # measured twice\r")
    expected = [COURSES.course[0].model_copy(update={"x": 2.02}), *COURSES.course[1:], more]
    if inline:
        text = 'robot = "kiwi"  # ours\ncourse = [ { course = "left", begin = 50, end = 60 } ]  # measured twice\r\n'
        expected = [COURSES.course[2], more]
    new = with_course(text, more)
    assert read_courses(new, "courses.toml", config).course == expected
    assert "# measured twice\r\n" in new


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('robot = "kiwi"', 'robot = "moby"', "robot = 'moby': the robot file is that of kiwi"),
        ("end = 20", "end = 10", "end = 10: must be a later cycle than begin = 10"),
        ("tape = 0.003", "tape = -1.0", "tape = -1.0"),
        ("x = 2.01", "x = nan", "x = nan"),
        ('course = "forward"', 'course = "foreward"', "forward"),
        ("begin = 10", "start = 10", "start"),
    ],
)
def test_a_wrong_file_of_courses_is_refused(old: str, new: str, said: str) -> None:
    text = courses_text(COURSES)
    assert old in text
    with pytest.raises(ConfigError, match=said.replace("(", r"\(")):
        read_courses(text.replace(old, new, 1), "courses.toml", parse(TRUE["kiwi"](), "kiwi"))


@pytest.mark.parametrize("name", ["moby", "omni4", "mecanum4"])
def test_courses_keep_within_the_limits_and_close(name: str) -> None:
    config = parse(robot_text(name), name)
    limits = config.limits.velocity
    for course in CourseName:
        ways = [(leg.twist, leg.seconds) for leg in legs(course, 1.5, config)]
        assert all(abs(one.vx) <= min(SPEED, limits.vx) and abs(one.vy) <= min(SPEED, limits.vy) for one, _ in ways)
        assert all(abs(one.wz) <= limits.wz for one, _ in ways)
        x, y = (sum(twist[axis] * seconds for twist, seconds in ways) for axis in (0, 1))
        if "square" in course.value:
            assert len(ways) == 4
            assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-9)
        elif "turn" not in course.value:
            assert x * x + y * y == pytest.approx(1.5**2)


def test_which_robots_are_measured_by_courses() -> None:
    for name in BUNDLED:
        config = parse(robot_text(name), name)
        if config.robot.kind in GEOMETRY:
            assert geometry_courses(config) == GEOMETRY[config.robot.kind]
        else:
            with pytest.raises(CourseError, match="kind odd: measured courses are for offset_differential, omni"):
                geometry_courses(config)


def test_numbers_go_into_the_file_with_their_notes() -> None:
    text = TRUE["mobyish"]()
    entries = [
        Entry(("robot", "track"), 0.341, "m, measured"),
        Entry(("odometry", "variance_per_metre"), 2e-4, "m^2/m, measured"),
    ]
    new = with_entries(text, entries, "mobyish")
    assert "track = 0.341 # m, measured\n" in new
    assert "[odometry]\nvariance_per_metre = 0.0002 # m^2/m, measured\n" in new
    config = parse(new, "mobyish")
    assert config.odometry.growth() == CHOSEN_GROWTH._replace(position=2e-4)
    kept = [line for line in new.splitlines() if "measured" not in line and line != "[odometry]"]
    assert [line for line in kept if line] == [
        line for line in text.splitlines() if line and not line.startswith("track")
    ]
    again = with_entries(new, [Entry(("robot", "track"), 0.342, "m, anew")], "mobyish")
    assert "track = 0.342 # m, anew\n" in again
    assert "0.341" not in again


def test_wheels_in_inline_tables_get_their_note_behind_all_of_them() -> None:
    text = TRUE["kiwi"]()
    wheels = parse(text, "kiwi").robot.model_dump()["wheel"]
    keys = ("x", "y", "axis_angle", "radius")
    rows = ", ".join(
        f'{{ motor = "{one["motor"]}", {", ".join(f"{key} = {one[key]}" for key in keys)} }}' for one in wheels
    )
    head, _, rest = text.partition("\n[[robot.wheel]]")
    start = head.replace('name = "kiwi"', f'name = "kiwi"\nwheel = [{rows}]')
    inline = f"{start}\n[limits]{rest.partition('[limits]')[2]}"
    new = with_entries(inline, [Entry(("robot", "wheel", 1, "radius"), 0.0512, "m, measured")], "kiwi")
    assert parse(new, "kiwi").robot.model_dump()["wheel"][1]["radius"] == 0.0512
    assert "] # m, measured" in new


def test_options_in_a_table_of_their_own_keep_what_is_said_of_them() -> None:
    text = robot_text("moby")
    inline = 'options = { firmware = "0.6.10", watchdog_enable_endpoint = 188, '
    assert inline in text
    head, _, rest = text.partition(inline)
    rest = rest.partition("\n")[2]
    keys = ["firmware", "watchdog_enable_endpoint", "watchdog_timeout_endpoint", "endpoints_of"]
    values = ['"0.6.10"', "188", "189", '"0.6.10 0.0.0"']
    lines = [f"options.{key} = {value}  # by me" for key, value in zip(keys, values, strict=True)]
    dotted = f"{head}{chr(10).join(lines)}\n{rest}"
    options: dict[str, str | int] = {"watchdog_enable_endpoint": 1, "watchdog_timeout_endpoint": 2}
    new = with_options(dotted, {"left": options}, None, "moby")
    assert parse(new, "moby").motor[0].options == {"firmware": "0.6.10", **options, "endpoints_of": "0.6.10 0.0.0"}
    assert new.count("# by me") == len(keys)


def test_what_no_robot_can_have_is_not_written() -> None:
    with pytest.raises(CorrectionError, match="cannot be changed"):
        with_entries(TRUE["mobyish"](), [Entry(("robot", "track"), -1.0, "m")], "mobyish")
    with pytest.raises(CorrectionError, match="cannot be changed"):
        with_entries(TRUE["kiwi"](), [Entry(("robot", "wheel", 7, "radius"), 0.05, "m")], "kiwi")


@pytest.mark.parametrize(("half", "value"), [(0.00013, 0.080137), (0.002, 0.08014), (0.5, 0.08), (0.0, 0.0801371)])
def test_numbers_are_as_long_as_they_are_sure(half: float, value: float) -> None:
    assert rounded(0.0801371, half) == pytest.approx(value, abs=0.01 * half)
