"""Geometry from measured courses: true robots that differ from their files, UMBmark by hand, and every refusal."""

from collections.abc import Callable, Sequence
from math import cos, pi, sin, tan
from pathlib import Path

import numpy as np
import pytest

from gateway.chassis.mecanum import MecanumRobot
from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.chassis.omni import OmniRobot
from gateway.config import RobotConfig, parse
from gateway.core.odometry import WheelOdometry
from gateway.setup.courses import GEOMETRY, Course, CourseError, CourseName, Courses
from gateway.types import Growth
from replay.calibrate.calibrate import calibrated
from replay.calibrate.umbmark import umbmark
from replay.calibrate.ways import Array, Driven, driven, mapping, steps, traced
from replay.sessions.reader import open_session
from replay.sim.plants import plant_of
from tests.replay import mujoco_plant
from tests.replay.measured_courses import Body, drive_courses, tape_of, with_tape
from tests.setup_robots import TRUE
from tests.world import robot_text

NAMES = ("mobyish", "kiwi", "omni4", "rectangular")
COURSE = Course(course=CourseName.FORWARD, begin=0, end=1)
Robot = OffsetDifferentialRobot | OmniRobot | MecanumRobot
FORWARD, LEFT, BACKWARD, RIGHT = CourseName.FORWARD, CourseName.LEFT, CourseName.BACKWARD, CourseName.RIGHT
TURNS = (CourseName.TURN_LEFT, CourseName.TURN_RIGHT)


def text_of(name: str) -> str:
    return TRUE[name]() if name in TRUE else robot_text(name)


def config_of(name: str) -> RobotConfig:
    return parse(text_of(name), name)


def robot_of(config: RobotConfig) -> Robot:
    assert isinstance(config.robot, Robot)
    return config.robot


def other(robot: Robot, rng: np.random.Generator) -> Robot:
    """As a robot is whose file was written by ruler: lengths off by 4 %, places by 1 cm, angles by 1.7 degrees."""

    def off(by: float) -> float:
        return float(rng.uniform(-by, by))

    if isinstance(robot, OffsetDifferentialRobot):
        lengths = {key: getattr(robot, key) * (1.0 + off(0.04)) for key in ("wheel_radius", "axle_offset", "track")}
        return robot.model_copy(update=lengths)
    angle = "axis_angle" if isinstance(robot, OmniRobot) else "roller_angle"
    wheels = [
        wheel.model_copy(
            update={
                "radius": wheel.radius * (1.0 + off(0.02)),
                "x": wheel.x + off(0.01),
                "y": wheel.y + off(0.01),
                angle: getattr(wheel, angle) + off(0.03),
            }
        )
        for wheel in robot.wheel
    ]
    return robot.model_copy(update={"wheel": wheels})


def truth_of(true: Robot, name: str) -> float:
    """What the number of this name truly is."""
    if isinstance(true, OffsetDifferentialRobot):
        return float(getattr(true, name))
    motor, key = name.split(".")
    if isinstance(true, OmniRobot):
        (omni,) = (wheel for wheel in true.wheel if wheel.motor == motor)
        lever = cos(omni.axis_angle) * omni.x + sin(omni.axis_angle) * omni.y
        return {"radius": omni.radius, "axis_angle": omni.axis_angle, "lever": lever}[key]
    (wheel,) = (wheel for wheel in true.wheel if wheel.motor == motor)
    lever = tan(wheel.roller_angle) * wheel.x - wheel.y
    return {"radius": wheel.radius, "roller_angle": wheel.roller_angle, "lever": lever}[key]


def courses_of(config: RobotConfig) -> Courses:
    return Courses(robot=config.robot.name, course=[COURSE])


def driven_by(
    config: RobotConfig, true: Robot, plan: Sequence[CourseName], *, ratio: float = 1.0, zero: float = 0.0
) -> list[Driven]:
    body = Body(config, true, ratio=ratio, zero=zero)
    return [body.drive(place, name) for place, name in enumerate(plan)]


def taped(config: RobotConfig, runs: Sequence[Driven], rng: np.random.Generator) -> list[Driven]:
    return [one._replace(end=tape_of(courses_of(config), one.end, rng)) for one in runs]


@pytest.mark.parametrize("name", NAMES)
def test_intervals_hold_the_truth_as_often_as_they_say(name: str) -> None:
    rng = np.random.default_rng(7)
    config = config_of(name)
    held: list[bool] = []
    for _ in range(5):
        true = other(robot_of(config), rng)
        ratio, zero = float(rng.uniform(0.995, 1.005)), float(rng.uniform(-0.02, 0.02))
        runs = driven_by(config, true, GEOMETRY[config.robot.kind] * 2, ratio=ratio, zero=zero)
        for _ in range(10):
            found = calibrated(config, courses_of(config), taped(config, runs, rng))
            assert not found.refused
            held += [abs(one.value - truth_of(true, one.name)) <= one.half for one in found.numbers]
            beside = {"wheel_ratio": ratio, "joint_zero": zero}
            held += [abs(one.value - beside[one.name]) <= one.half for one in found.told]
    # Numbers of a fit hang together, so this is one of about 50 to 150 independent ones.
    assert 0.90 < np.mean(held) < 0.99


def check_simulated(tmp_path: Path, name: str, plant: Callable[[Robot], object], plan: Sequence[CourseName]) -> None:
    rng = np.random.default_rng(3)
    config = config_of(name)
    true = other(robot_of(config), rng)
    courses = drive_courses(tmp_path, text_of(name), plan, plant(true), length=0.8)  # type: ignore[arg-type]
    session = open_session(Path(str(courses.course[0].session)))
    for measured in (courses, with_tape(courses, rng)):
        found = calibrated(config, measured, driven(session, list(enumerate(measured.course)), config))
        assert not found.refused
        assert len(found.numbers) in (3, 9, 12)
        # Three standard errors: this is one draw of many numbers, not the coverage.
        assert all(abs(one.value - truth_of(true, one.name)) < 1.5 * one.half for one in found.numbers)
        assert any(abs(one.old - truth_of(true, one.name)) > one.half for one in found.numbers)
        assert found.after[0] < 0.4 * found.before[0]
        assert found.before[1] > 0.02


@pytest.mark.parametrize(
    ("name", "plan"),
    [
        ("mobyish", (FORWARD, LEFT, BACKWARD, RIGHT, CourseName.SQUARE_LEFT)),
        ("kiwi", (FORWARD, LEFT, BACKWARD, RIGHT, CourseName.TURN_LEFT)),
        ("rectangular", (FORWARD, LEFT, BACKWARD, RIGHT, CourseName.TURN_LEFT)),
    ],
)
def test_a_simulated_robot_that_is_not_as_its_file_says(tmp_path: Path, name: str, plan: Sequence[CourseName]) -> None:
    check_simulated(tmp_path, name, plant_of, plan)


@pytest.mark.parametrize(
    ("name", "plant", "plan"),
    [
        ("kiwi", mujoco_plant.omni, (FORWARD, LEFT, BACKWARD, RIGHT, CourseName.TURN_RIGHT)),
        ("moby", mujoco_plant.offset_differential, (FORWARD, LEFT, BACKWARD, RIGHT, CourseName.SQUARE_LEFT)),
    ],
)
def test_the_same_on_bodies_in_contact(
    tmp_path: Path, name: str, plant: Callable[[Robot], object], plan: Sequence[CourseName]
) -> None:
    check_simulated(tmp_path, name, plant, plan)


@pytest.mark.parametrize("name", NAMES)
def test_ways_and_covariance_are_those_of_the_odometry(name: str) -> None:
    config = config_of(name)
    (one,) = driven_by(config, robot_of(config), [CourseName.SQUARE_LEFT])
    kinematics = config.robot.kinematics()
    growths = (4e-4, 3e-4, 2e-4)
    odometry = WheelOdometry(
        kinematics, top_speeds=[1e3] * len(one.angles), sideways=config.robot.SIDEWAYS, growth=Growth(*growths)
    )
    told = odometry.read(None, None)
    for before, now in zip(one.angles.T, one.angles.T[1:], strict=False):
        odometry.update(list(now - before), list(now), residual=None, dt=0.05)
        told = odometry.read(None, None)
    trace = traced(steps(one.angles, mapping(kinematics), kinematics.steered), config.robot.SIDEWAYS)
    assert trace.end == pytest.approx(told.pose, abs=1e-9)
    first = 1e-6  # with which it begins
    x, y, _ = told.pose
    lever = np.array([-y, x, 1.0])
    begun = first * (np.outer(lever, lever) + np.diag([1.0, 1.0, 0.0]))
    grown = np.tensordot(growths, trace.grown, axes=1)
    assert np.array(told.covariance).reshape(3, 3) - begun == pytest.approx(grown, rel=1e-6, abs=1e-12)


def square_end(sign: int, *, length: float, alpha: float, beta: float) -> tuple[float, float]:
    """Where a square ends whose corners turn alpha too little and whose sides turn beta to the left; exact arcs."""
    x = y = heading = 0.0
    for _ in range(4):
        chord = length * (sin(beta / 2.0) / (beta / 2.0) if beta else 1.0)
        x += chord * cos(heading + beta / 2.0)
        y += chord * sin(heading + beta / 2.0)
        heading += beta + sign * (pi / 2.0 - alpha)
    return x, y


def test_umbmark_by_hand() -> None:
    """L = 4 m, b = 0.34 m: alpha = 0.01 is Eb = (pi/2)/(pi/2 - 0.01) = 1.006407; beta = 0.004 is R = 2/sin(0.002) =
    1000.0007 m, so Ed = (1000.0007 + 0.17)/(1000.0007 - 0.17) = 1.00034006. Centres of gravity to first order:
    -8 (0.006) = -0.048 and +0.048 to the left, -8 (0.014) = -0.112 and -0.112 to the right.
    """
    found = umbmark([(-0.048, 0.048)], [(-0.112, -0.112)], length=4.0, track=0.34)
    assert found.alpha == pytest.approx(0.01)
    assert found.beta == pytest.approx(0.004)
    assert found.track_ratio == pytest.approx(1.006407, abs=1e-6)
    assert found.wheel_ratio == pytest.approx(1.00034006, abs=1e-8)
    assert found.error == pytest.approx(0.112 * 2**0.5)


@pytest.mark.parametrize(("alpha", "beta"), [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.01), (0.01, -0.004), (-0.03, 0.02)])
def test_umbmark_of_exact_squares(alpha: float, beta: float) -> None:
    left = square_end(1, length=4.0, alpha=alpha, beta=beta)
    right = square_end(-1, length=4.0, alpha=alpha, beta=beta)
    found = umbmark([left], [right], length=4.0, track=0.34)
    assert found.alpha == pytest.approx(alpha, abs=2e-3)  # it is of first order
    assert found.beta == pytest.approx(beta, abs=2e-3)


def test_umbmark_of_an_offset_differential_robot() -> None:
    """A track 3 % too large in the file, and a right wheel 0.3 % larger: both ratios, before; nothing is left after."""
    config = config_of("mobyish")
    robot = robot_of(config)
    assert isinstance(robot, OffsetDifferentialRobot)
    true = robot.model_copy(update={"track": 0.97 * robot.track})
    runs = driven_by(config, true, GEOMETRY["offset_differential"], ratio=1.003)
    found = calibrated(config, courses_of(config), runs)
    assert found.squares is not None
    assert found.squares_after is not None
    assert found.squares.track_ratio == pytest.approx(0.97, abs=0.003)
    assert found.squares.wheel_ratio == pytest.approx(1.003, abs=5e-4)
    assert found.squares.error > 0.2
    assert found.squares_after.error < 1e-3
    told = {one.name: one for one in found.told}
    assert told["wheel_ratio"].value == pytest.approx(1.003, abs=1e-5)


def refusal(config: RobotConfig, runs: Sequence[Driven]) -> str:
    with pytest.raises(CourseError) as error:
        calibrated(config, courses_of(config), runs)
    return str(error.value)


def kiwi_runs(plan: Sequence[CourseName]) -> tuple[RobotConfig, list[Driven]]:
    config = config_of("kiwi")
    return config, taped(config, driven_by(config, robot_of(config), plan), np.random.default_rng(1))


def mobyish_runs(plan: Sequence[CourseName], **how: float) -> tuple[RobotConfig, list[Driven]]:
    config = config_of("mobyish")
    return config, taped(config, driven_by(config, robot_of(config), plan, **how), np.random.default_rng(1))


def test_too_few_numbers_are_refused() -> None:
    config, runs = kiwi_runs((FORWARD, LEFT, CourseName.TURN_LEFT))
    assert refusal(config, runs).startswith("9 numbers were measured, and 9 are sought: at least 3 more")


@pytest.mark.parametrize(
    ("plan", "missing"),
    [
        ((FORWARD, BACKWARD, *TURNS), "to the side"),
        ((LEFT, RIGHT, *TURNS), "forward or back"),
        ((FORWARD, LEFT, BACKWARD, RIGHT), "a turn"),
    ],
)
def test_a_way_to_move_that_was_not_driven_is_named(plan: Sequence[CourseName], missing: str) -> None:
    config, runs = kiwi_runs(plan)
    assert f"not every way to move was driven; drive also: {missing}" in refusal(config, runs)


def test_wheels_whose_intervals_are_wide_stay_as_they_are() -> None:
    config, runs = kiwi_runs((FORWARD, LEFT, *TURNS))
    courses = courses_of(config).model_copy(update={"tape": 0.03})
    found = calibrated(config, courses, runs)
    assert found.refused
    reasons = {one.name: one.reason for one in found.refused}
    assert not reasons.keys() & {one.name for one in found.numbers}
    # Three numbers of a wheel are written together or not at all.
    for wheel in {name.split(".")[0] for name in reasons}:
        own = [reasons[f"{wheel}.{key}"] for key in ("radius", "axis_angle", "lever")]
        wide = [one for one in own if one.startswith("only to +-")]
        assert wide
        assert all(one in wide or one.startswith(f"goes with {wheel}.") for one in own)


def test_an_interval_that_is_wide_says_what_would_show_the_number() -> None:
    """One line sideways, by a tape that is good for 2 cm."""
    config, runs = mobyish_runs((FORWARD, LEFT, CourseName.SQUARE_LEFT, CourseName.SQUARE_RIGHT))
    found = calibrated(config, courses_of(config).model_copy(update={"tape": 0.02}), runs)
    (refused,) = found.refused
    assert refused.name == "axle_offset"
    assert refused.reason.startswith("only to +-0.0")
    assert "m, more than 0.01: only courses that end with the chassis turned another way" in refused.reason


def test_what_an_offset_differential_course_does_not_show_is_refused() -> None:
    """The chassis never turns: radius and ratio, and neither offset nor track."""
    config, runs = mobyish_runs([FORWARD] * 4)
    found = calibrated(config, courses_of(config), runs)
    assert [one.name for one in found.numbers] == ["wheel_radius"]
    reasons = {one.name: one.reason for one in found.refused}
    assert "chassis turned another way" in reasons["axle_offset"]
    assert "squares both ways" in reasons["track"]


def test_squares_alone_do_not_show_the_axle_offset() -> None:
    """They end with the chassis as it stood at their start, but for the first; a line shows what a metre is."""
    config, runs = mobyish_runs([FORWARD, *[CourseName.SQUARE_LEFT] * 3, CourseName.SQUARE_RIGHT, RIGHT])
    body = Body(config, config.robot, phi=-pi / 2.0)
    right = [body.drive(place, CourseName.SQUARE_RIGHT) for place in range(4)]
    found = calibrated(config, courses_of(config), [runs[0], *runs[2:4], *right[1:]])
    assert [one.name for one in found.refused] == ["axle_offset"]
    assert {one.name for one in found.numbers} == {"wheel_radius", "track"}


def test_squares_one_way_round_mix_track_and_wheels() -> None:
    """As Borenstein and Feng warn: a wrong track and unequal wheels may make up for each other."""
    config, runs = mobyish_runs([CourseName.SQUARE_LEFT] * 5)
    said = refusal(config, runs[1:])
    assert said.startswith(
        "wheel_radius: these courses do not tell it (only mixed with wheel_radius, axle_offset, track"
    )
    assert "squares both ways" in said


def test_a_mistyped_number_names_its_course() -> None:
    config, runs = mobyish_runs(GEOMETRY["offset_differential"] * 2)
    runs[7] = runs[7]._replace(end=runs[7].end + np.array([0.3, 0.0, 0.0]))
    assert refusal(config, runs).startswith("course 7 (left): does not fit the others: it ends +0.3")


def test_ends_that_no_geometry_explains_are_refused() -> None:
    """Each course is off by half a metre its own way, as on ice."""
    config, runs = mobyish_runs(GEOMETRY["offset_differential"] * 2)
    rng = np.random.default_rng(2)
    runs = [one._replace(end=one.end + np.append(rng.normal(0.0, 0.5, 2), 0.0)) for one in runs]
    assert "more than tape (0.003 m, 0.005 rad) and the odometry's own covariance explain" in refusal(config, runs)


def test_a_file_far_from_the_robot_is_refused() -> None:
    config, runs = mobyish_runs(GEOMETRY["offset_differential"])
    runs = [one._replace(angles=one.angles * np.array([[3.0], [3.0], [1.0]])) for one in runs]
    assert "no geometry near that of the robot file" in refusal(config, runs)


def test_wheels_that_slip_are_refused() -> None:
    config = config_of("omni4")
    runs = driven_by(config, robot_of(config), GEOMETRY["omni"])
    runs[0].angles[0] += np.linspace(0.0, 3.0, runs[0].angles.shape[1])
    runs[0].angles[1] -= np.linspace(0.0, 3.0, runs[0].angles.shape[1])
    assert refusal(config, runs).startswith("wheels slipped: ")


def test_another_kind_of_chassis_is_refused() -> None:
    config = config_of("odd")
    one = Driven("course 0", COURSE, np.zeros((4, 3)), np.zeros(3))
    assert "not calibrated" in refusal(config, [one])


def test_what_was_not_measured_is_left_out() -> None:
    """Tape along the line alone tells the radius; nothing is taken for zero."""
    config, runs = mobyish_runs([FORWARD] * 4, ratio=1.01)
    runs = [one._replace(end=one.end * np.array([1.0, np.nan, np.nan])) for one in runs]
    found = calibrated(config, courses_of(config), runs)
    assert [one.name for one in found.numbers] == ["wheel_radius"]
    assert found.after[1] == 0.0
    assert not found.told


# -- from sessions ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Courses:
    folder = tmp_path_factory.mktemp("recorded")
    return drive_courses(folder, TRUE["mobyish"](), [FORWARD], plant_of(config_of("mobyish").robot), length=0.5)


def read(courses: Courses, *, text: Callable[[str], str] = str, begin: int = 0, end: int = 0) -> list[Driven]:
    (one,) = courses.course
    moved = one.model_copy(update={"begin": one.begin + begin, "end": one.end + end})
    config = parse(text(TRUE["mobyish"]()), "mobyish")
    return driven(open_session(Path(str(one.session))), [(0, moved)], config)


def test_how_wheels_turned_is_read_from_the_session(recorded: Courses) -> None:
    (one,) = read(recorded)
    way: Array = steps(one.angles, mapping(config_of("mobyish").robot.kinematics()), (2,))
    assert traced(way, (1.0, 1.0)).end == pytest.approx(one.end, abs=1e-3)
    assert one.end[0] == pytest.approx(0.5, abs=0.01)


def test_what_a_session_cannot_tell_is_refused(recorded: Courses) -> None:
    with pytest.raises(CourseError, match=r"course 0 \(forward\): left turns at its begin or end"):
        read(recorded, begin=200)
    with pytest.raises(CourseError, match=r"turns at its begin or end"):
        read(recorded, end=-350)
    with pytest.raises(CourseError, match=r"cycle \d+ is not in the recording"):
        read(recorded, end=1000)
    with pytest.raises(CourseError, match="recorded with other motors"):
        read(recorded, text=lambda text: text.replace("gear_ratio = 12.0", "gear_ratio = 11.0", 1))
