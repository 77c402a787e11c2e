"""Layouts that cannot be driven, or hardly, are told in words of who builds them: which motion, and what is meant."""

from collections.abc import Callable, Mapping, Sequence
from math import atan2, cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.chassis.contract import Chassis
from gateway.chassis.mecanum import MecanumRobot
from gateway.chassis.odd import OddRobot
from gateway.chassis.omni import OmniRobot
from gateway.config import load
from gateway.kinematics.contract import GeometryError
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.linear import Matrix
from gateway.kinematics.undriven import undriven
from gateway.robot_files import bundled
from tests.chassis_figures import SHOWN

RECTANGLE = {
    "front_left": (0.2, 0.16),
    "rear_left": (-0.2, 0.16),
    "rear_right": (-0.2, -0.16),
    "front_right": (0.2, -0.16),
}
SQUARE = {
    "front_left": (0.2, 0.2),
    "rear_left": (-0.2, 0.2),
    "rear_right": (-0.2, -0.2),
    "front_right": (0.2, -0.2),
}
OUTWARD = [atan2(y, x) for x, y in RECTANGLE.values()]
OUTWARD_SQUARE = [atan2(y, x) for x, y in SQUARE.values()]
E = pi / 4  # 45 degrees
Places = Mapping[str, tuple[float, float]]


def with_wheels(kind: str, angle: str, angles: Sequence[float], places: Places) -> dict[str, object]:
    wheels = [
        {"motor": motor, "x": x, "y": y, angle: given, "radius": 0.05}
        for (motor, (x, y)), given in zip(places.items(), angles, strict=True)
    ]
    return {"kind": kind, "name": "r", "body": {"mass": 20.0, "inertia": 1.0}, "wheel": wheels}


def omni(*angles: float, places: Places = RECTANGLE) -> OmniRobot:
    return OmniRobot.model_validate(with_wheels("omni", "axis_angle", angles, places))


def mecanum(*angles: float, places: Places = RECTANGLE) -> MecanumRobot:
    return MecanumRobot.model_validate(with_wheels("mecanum", "roller_angle", angles, places))


def odd(*angles: float, narrowest: float = 0.25) -> OddRobot:
    head = {"kind": "odd", "name": "r", "body": {"mass": 20.0, "inertia": 1.0}, "wheels": list(RECTANGLE)}
    sizes = {"radius": 0.07, "spacing": 0.1, "narrowest": narrowest, "widest": 0.6, "width": 0.4}
    return OddRobot.model_validate(head | sizes | {"roller_angles": angles})


def at_one_place(*angles: float) -> OmniRobot:
    return omni(*angles, places={f"m{place}": (0.3, 0.1) for place in range(len(angles))})


CROSS = (
    "Rollers of front_left and rear_right must go one way (roller_angle = -0.7854), those of rear_left and front_right "
    "the other (0.7854): on top of the wheels, seen from above, they make an X"
)
AXLES = (
    "axis_angle is that of the axle, outward; from the middle through each wheel it would be 0.6747 (front_left), "
    "2.467 (rear_left), -2.467 (rear_right), -0.6747 (front_right)"
)
NOTHING = "that turns no wheel, so no wheel drives or holds it"

# Each with what is told. What cannot be moved is derived by hand: an omni wheel slides along its axle, a mecanum wheel
# across its roller, so wheels that are all alike slide that way together; wheels that all push towards one point turn
# nothing about it.
REFUSED: dict[str, tuple[Chassis, list[str]]] = {
    "omni, axles all forward": (omni(0, 0, 0, 0), ["cannot move forward or backward", NOTHING, AXLES]),
    "omni, axles all sideways": (omni(*[pi / 2] * 4), ["cannot move sideways", NOTHING, AXLES]),
    "omni, axles all slanted": (omni(E, E, E, E), ["cannot move along the line 45 degrees to the left of", AXLES]),
    "omni, two and two opposite": (omni(E, E, E - pi, E - pi), ["the line 45 degrees to the left of forward", AXLES]),
    "omni, wheels given as they roll": (
        omni(*[angle + pi / 2 for angle in OUTWARD_SQUARE], places=SQUARE),
        ["cannot turn on the spot", "it would be 0.7854 (front_left), 2.356 (rear_left), -2.356 (rear_right)"],
    ),
    "omni, all at one place": (at_one_place(0.0, 2.0, 4.0), ["cannot turn about the point x = 0.3, y = 0.1 m"]),
    "omni, one wheel three times": (
        at_one_place(0.0, 0.0, 0.0),
        ["move forward or backward", "nor ", "turn about the point"],
    ),
    "mecanum, rollers all alike": (mecanum(E, E, E, E), ["cannot move along the line 45 degrees to the right", CROSS]),
    "mecanum, all the other way": (mecanum(-E, -E, -E, -E), ["the line 45 degrees to the left of forward", CROSS]),
    "mecanum, ordinary wheels": (mecanum(0, 0, 0, 0), ["cannot move sideways", NOTHING, CROSS]),
    "mecanum, a square with the O": (mecanum(E, -E, E, -E, places=SQUARE), ["cannot turn on the spot", CROSS]),
    "mecanum, rollers across": (mecanum(*[pi / 2] * 4), ["its axis lies across the wheel", "drives nothing", CROSS]),
    "odd, rollers all alike": (odd(E, E, E, E), ["cannot move along the line 45 degrees to the right", "must differ"]),
    "odd, alike in each pair": (odd(E, E, -E, -E), ["cannot move forward or backward while opening or closing"]),
    "odd, ordinary wheels": (odd(0, 0, 0, 0), ["move sideways", "nor ", "open or close"]),
    "odd, in the middle of its range": (
        odd(1.10714872, E, E, -1.24904577, narrowest=0.1),
        ["At a width of 0.175 m it cannot turn about the point"],
    ),
    "odd, hardly less than nothing": (
        odd(E, E - 1e-6, E, E + 1e-6),
        ["At a width of", "it cannot move along the line 45 degrees to the right"],
    ),
}
DOUBTED: dict[str, tuple[Chassis, list[str]]] = {
    "omni, nearly all alike": (omni(0.0, 0.02, -0.02, 0.01), ["can hardly move forward or backward (1.5 %)", AXLES]),
    "omni, an axle inward": (
        omni(OUTWARD[0], OUTWARD[1] + pi, OUTWARD[2], OUTWARD[3]),
        ["axis_angle of rear_left points inward", "turns the robot clockwise"],
    ),
    "omni, all axles inward": (omni(*[angle + pi for angle in OUTWARD]), ["front_left and rear_left and rear_right"]),
    "mecanum, the O": (mecanum(E, -E, E, -E), ["turn it with 11% of the force", CROSS]),
    "mecanum, front one way": (mecanum(E, -E, -E, E), ["turn it with 71% of the force", CROSS]),
    "mecanum, left one way": (mecanum(E, E, -E, -E), ["turn it with 71% of the force", CROSS]),
    "mecanum, one wheel wrong": (mecanum(-E, E, -E, -E), ["of the force", CROSS]),
    "mecanum, nearly ordinary wheels": (mecanum(-0.01, 0.01, -0.01, 0.01), ["can hardly move sideways (1 %)", CROSS]),
    "odd, nearly alike": (odd(E, E - 0.02, E, E - 0.02), ["at a width of 0.25 m it can hardly"]),
}
GOOD: dict[str, Chassis] = {
    **{kind: load(bundled()[name])[0].robot for kind, name in SHOWN.items()},
    "omni, outward": omni(*OUTWARD),
    "mecanum, the X": mecanum(-E, E, -E, E),
    "mecanum, the X, with angles beyond a quarter turn": mecanum(3 * E, E, 3 * E, -3 * E),
    "mecanum, a square with the X": mecanum(-E, E, -E, E, places=SQUARE),
    "mecanum, flatter rollers": mecanum(-0.6, 0.6, -0.6, 0.6),
    "odd, mirrored": odd(-E, E, -E, E),
    "odd, mirrored pairs": odd(-E, E, E, -E),
}


@pytest.mark.parametrize("layout", REFUSED)
def test_what_cannot_be_driven(layout: str) -> None:
    robot, words = REFUSED[layout]
    with pytest.raises(GeometryError) as refused:
        robot.kinematics()
    assert [word for word in words if word not in str(refused.value)] == [], refused.value
    assert "condition" not in str(refused.value)


@pytest.mark.parametrize("layout", DOUBTED)
def test_what_is_hardly_meant(layout: str) -> None:
    robot, words = DOUBTED[layout]
    told = " ".join(robot.doubts())
    assert [word for word in words if word not in told] == [], told


@pytest.mark.parametrize("layout", GOOD)
def test_of_a_good_layout_nothing_is_said(layout: str) -> None:
    assert GOOD[layout].doubts() == ()


def test_the_hint_is_a_layout_that_drives() -> None:
    """What is proposed is taken, and nothing is said of it."""
    assert omni(0.6747, 2.467, -2.467, -0.6747).doubts() == ()
    assert mecanum(-0.7854, 0.7854, -0.7854, 0.7854).doubts() == ()


def test_without_a_better_layout_none_is_proposed() -> None:
    in_line = {f"m{place}": (0.1 * place, 0.0) for place in range(4)}
    for robot in (omni(0, 0, 0, 0, places=in_line), mecanum(E, E, E, E, places=in_line)):
        with pytest.raises(GeometryError) as refused:
            robot.kinematics()
        assert str(refused.value).endswith(NOTHING)


ROW = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))


@given(st.lists(ROW, min_size=3, max_size=6), st.floats(-3.1, 3.1))
@settings(max_examples=100, deadline=None)
def test_a_motion_that_is_taken_out_is_the_one_that_is_told(given_rows: Matrix, angle: float) -> None:
    """Rows at right angles to a direction on the floor: numpy's null space has it, and so have the words."""
    x, y = cos(angle), sin(angle)
    rows = [(a - (a * x + b * y) * x, b - (a * x + b * y) * y, c) for a, b, c in given_rows]
    if np.linalg.svd(np.array(rows))[1][1] < 0.1:
        return  # more than this is lost
    told = undriven(tuple(rows), 1.0, least=1e-6)
    assert len(told) == 1
    assert told[0].words.startswith("move ")
    assert told[0].share == pytest.approx(0.0, abs=1e-9)


PLACE = st.sampled_from([0.0, 0.0, 0.2, -0.2, 0.16, 1e-9, 10.0])
TURN = st.sampled_from([0.0, E, -E, 2 * E, 3 * E, pi, 1e-9, 0.3, 6.3])
POSES = st.lists(st.tuples(PLACE, PLACE, TURN), min_size=3, max_size=6)


@given(POSES, st.sampled_from([omni, mecanum]))
@settings(max_examples=300, deadline=None)
def test_any_layout_is_driven_or_refused_in_words(
    poses: list[tuple[float, float, float]], make: Callable[..., Chassis]
) -> None:
    robot = make(*[angle for *_, angle in poses], places={f"m{at}": (x, y) for at, (x, y, _) in enumerate(poses)})
    try:
        robot.kinematics()
    except GeometryError as refused:
        assert "cannot" in str(refused) or "drives nothing" in str(refused)
        return
    assert all(words.startswith("robot.") for words in robot.doubts())


def test_a_lever_that_is_nothing_but_rounding_turns_nothing() -> None:
    """1e-17 m, as cos(pi / 2) has it: a robot whose wheels all push through its middle."""
    rows = [(sin(angle), cos(angle), 1e-17) for angle in (0.0, 1.0, 2.0, 4.0)]
    with pytest.raises(GeometryError, match="cannot turn on the spot"):
        FixedWheels(rows, [0.05] * 4)
