"""Four mecanum wheels in line with a width that changes: both directions, what is refused, open-loop paths.

Of the acceptance list: O1, O2, O3 and O5.
"""

from collections.abc import Callable
from itertools import product
from math import atan, cos, inf, isfinite, nan, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.kinematics.contract import GeometryError
from gateway.kinematics.mecanum import MecanumWheel, mecanum_kinematics, roller_tangent
from gateway.kinematics.odd import OddGeometry
from gateway.types import Rates

LAYOUTS = {
    "same way": (45.0, -45.0, 45.0, -45.0),
    "mirrored": (45.0, -45.0, -45.0, 45.0),
    "any": (30.0, -60.0, 50.0, -40.0),
    "one alike": (45.0, 45.0, 45.0, -45.0),  # sigma1 = -2 w at any width
}
every = pytest.mark.parametrize("layout", LAYOUTS)
axes = st.tuples(*[st.floats(-top, top) for top in (2.0, 2.0, 5.0, 1.0)])


def geometry(layout: str = "same way", /, **changed: float) -> OddGeometry:
    """With these sizes changed."""
    sizes = {"radius": 0.05, "spacing": 0.1, "narrowest": 0.2, "widest": 0.6, **changed}
    return OddGeometry([radians(angle) for angle in LAYOUTS[layout]], **sizes)


@every
@given(rates=axes, width=st.floats(0.2, 0.6))
def test_there_and_back(layout: str, rates: Rates, width: float) -> None:
    chassis = geometry(layout)
    speeds = chassis.wheel_speeds(rates, width)
    assert speeds is not None
    assert chassis.rates(speeds, width) == pytest.approx(rates, abs=1e-11)


@every
@given(speeds=st.tuples(*[st.floats(-50.0, 50.0)] * 4), width=st.floats(0.2, 0.6))
def test_the_closed_form_is_the_inverse_of_the_rows(layout: str, speeds: Rates, width: float) -> None:
    chassis = geometry(layout)
    solved = np.linalg.solve(np.array(chassis.rim_rows(width)), 0.05 * np.array(speeds))
    assert chassis.rates(speeds, width) == pytest.approx(solved, abs=1e-10)
    sides = chassis.sides(speeds, width)
    assert sides is not None
    vx, vy, wz, rate = solved
    assert sides.left == pytest.approx((vx - 0.5 * width * wz, vy + 0.5 * rate), abs=1e-10)
    assert sides.right == pytest.approx((vx + 0.5 * width * wz, vy - 0.5 * rate), abs=1e-10)


@pytest.mark.parametrize(
    ("layout", "ahead", "sideways", "turn", "width"),
    [
        ("same way", (1, 1, 1, 1), (0.2, -0.4, 0.4, -0.2), (-1, -1, 1, 1), (1, -1, -1, 1)),
        ("mirrored", (1, 1, 1, 1), (1, -1, -1, 1), (-1, -1, 1, 1), (0.2, -0.4, 0.4, -0.2)),
    ],
)
def test_each_wheel_by_hand(layout: str, ahead: Rates, sideways: Rates, turn: Rates, width: Rates) -> None:
    """d = 0.3, w = 0.1 m: the printed inverses, rows times 4, 4 (or 4 d), 2 d and 2 (or 2 d), of rim speeds."""
    chassis = geometry(layout)
    across, apart = (1.2, 2.0) if layout == "same way" else (4.0, 0.6)
    for wheel in range(4):
        got = chassis.rates([1.0 / 0.05 if place == wheel else 0.0 for place in range(4)], 0.3)
        want = (ahead[wheel] / 4.0, sideways[wheel] / across, turn[wheel] / 0.6, width[wheel] / apart)
        assert got == pytest.approx(want, abs=1e-12)


# what is refused


@pytest.mark.parametrize("angles", [(45, 45, -45, -45), (45, 45, 45, 45), (-30, -30, -30, -30), (0, 0, 45, -45)])
def test_singular_rollers_are_refused_in_words(angles: tuple[float, ...]) -> None:
    with pytest.raises(GeometryError, match=r"do not drive all four axes at every width from 0.2 to 0.6 m: sigma1 = "):
        OddGeometry([radians(angle) for angle in angles], radius=0.05, spacing=0.1, narrowest=0.2, widest=0.6)


def test_a_width_within_the_range_at_which_they_are_singular_is_refused() -> None:
    """T = (2, 1, 1, -3): sigma1 = 4 d - 7 w is zero at d = 0.175 m."""
    angles = [atan(tangent) for tangent in (2.0, 1.0, 1.0, -3.0)]
    with pytest.raises(GeometryError, match=r"from 0\.1 to 0\.6 m: sigma1 = -0\.3 to 1\.7 m, must keep its sign"):
        OddGeometry(angles, radius=0.05, spacing=0.1, narrowest=0.1, widest=0.6)
    beyond = OddGeometry(angles, radius=0.05, spacing=0.1, narrowest=0.2, widest=0.6)
    assert beyond.wheel_speeds((1.0, 0.0, 0.0, 0.0), 0.175) is None
    assert beyond.rates((1.0,) * 4, 0.175) is None


@pytest.mark.parametrize("angle", [pi / 2.0, -pi / 2.0, 1.5 * pi, pi / 2.0 + 9e-4, nan])
def test_a_roller_across_the_wheel_is_refused(angle: float) -> None:
    with pytest.raises(GeometryError, match=r"its axis lies across the wheel \(cosine .*at least 0\.001"):
        OddGeometry([angle, -0.8, 0.8, -0.8], radius=0.05, spacing=0.1, narrowest=0.2, widest=0.6)
    with pytest.raises(GeometryError, match="across the wheel"):
        mecanum_kinematics([MecanumWheel(0.1, 0.1, angle, 0.05)] * 4)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"narrowest": 0.09}, r"width from 0\.09 to 0\.6 m: must begin at the spacing of the wheels of a pair, 0\.1 m"),
        ({"widest": 0.19}, r"width from 0\.2 to 0\.19 m: .*end above its beginning"),
        ({"widest": inf}, "width from"),
        ({"narrowest": nan}, "width from"),
        ({"spacing": 0.0}, "width from"),
        ({"radius": 0.0}, r"radius = 0 m: must be above zero"),
        ({"radius": nan}, "radius = nan m"),
    ],
)
def test_sizes_that_cannot_be_are_refused(changed: dict[str, float], words: str) -> None:
    with pytest.raises(GeometryError, match=words):
        geometry("same way", **changed)


def test_three_wheels_are_refused() -> None:
    with pytest.raises(GeometryError, match="3 roller angles: must be 4"):
        OddGeometry([0.8, -0.8, 0.8], radius=0.05, spacing=0.1, narrowest=0.2, widest=0.6)


@pytest.mark.parametrize("angles", list(product((0.0, pi / 4, -pi / 4, pi / 2), repeat=4)))
def test_every_set_of_rollers_is_refused_or_exact(angles: Rates) -> None:
    """Which of them are singular is what the rank of the rows says, at the ends of the range and between."""
    rollers_fit = all(abs(cos(angle)) > 0.5 for angle in angles)
    ranks = [
        np.linalg.matrix_rank(
            [(1.0, t, -y, t * half) for t, y, half in zip(np.tan(angles), _places(width), _HALVES, strict=True)]
        )
        for width in (0.2, 0.4, 0.6)
    ]
    try:
        chassis = OddGeometry(angles, radius=0.05, spacing=0.1, narrowest=0.2, widest=0.6)
    except GeometryError:
        assert not rollers_fit or min(ranks) < 4
        return
    assert rollers_fit
    assert min(ranks) == 4
    speeds = chassis.wheel_speeds((0.3, -0.2, 0.5, 0.1), 0.4)
    assert speeds is not None
    assert chassis.rates(speeds, 0.4) == pytest.approx((0.3, -0.2, 0.5, 0.1), abs=1e-11)


_HALVES = (0.5, 0.5, -0.5, -0.5)


def _places(width: float) -> Rates:
    return (width / 2 + 0.05, width / 2 - 0.05, -width / 2 + 0.05, -width / 2 - 0.05)


@pytest.mark.parametrize("width", [nan, inf, -inf])
def test_a_width_that_is_no_number_gives_no_motion(width: float) -> None:
    assert geometry().wheel_speeds((0.1, 0.0, 0.0, 0.0), width) is None
    assert geometry().rates((1.0,) * 4, width) is None
    assert geometry().sides((1.0,) * 4, width) is None


@given(st.floats(-10.0, 10.0), axes)
def test_any_width_gives_numbers_or_nothing(width: float, rates: Rates) -> None:
    speeds = geometry("any").wheel_speeds(rates, width)
    assert speeds is None or all(map(isfinite, speeds))
    found = geometry("any").rates((1.0, 2.0, -3.0, 4.0), width)
    assert found is None or all(map(isfinite, found))


@pytest.mark.parametrize("unknown", range(4))
def test_every_wheel_is_needed(unknown: int) -> None:
    speeds = [None if place == unknown else 1.0 for place in range(4)]
    assert geometry().rates(speeds, 0.4) is None
    assert geometry().sides(speeds, 0.4) is None


# paths, open loop and with ideal wheels


Pose = tuple[float, float, float, float]  # x, y, heading, width
STEPS = 500


def drive(chassis: OddGeometry, pose: Pose, seconds: float, world: Callable[[float], Rates]) -> Pose:
    """Wheels are told what the inverse says of rates over time (along world axes); they move as the forward says."""

    def slope(at: Pose, t: float) -> Rates:
        _, _, heading, width = at
        vx, vy, wz, rate = world(t)
        c, s = cos(heading), sin(heading)
        speeds = chassis.wheel_speeds((c * vx + s * vy, c * vy - s * vx, wz, rate), width)
        assert speeds is not None
        moved = chassis.rates(speeds, width)
        assert moved is not None
        return c * moved[0] - s * moved[1], s * moved[0] + c * moved[1], moved[2], moved[3]

    h = seconds / STEPS
    for step in range(STEPS):
        middle = slope(_after(pose, slope(pose, step * h), h / 2.0), (step + 0.5) * h)
        pose = _after(pose, middle, h)
    return pose


def _after(pose: Pose, rates: Rates, h: float) -> Pose:
    x, y, heading, width = (old + rate * h for old, rate in zip(pose, rates, strict=True))
    return x, y, heading, width


def _leg(x: float, y: float) -> Callable[[float], Rates]:
    return lambda _: (x, y, 0.0, 0.0)


PATHS: dict[str, tuple[Callable[[float], Rates], ...]] = {
    "square": (_leg(0.5, 0.0), _leg(0.0, 0.5), _leg(-0.5, 0.0), _leg(0.0, -0.5)),
    "rhombus": (_leg(0.4, 0.3), _leg(-0.4, 0.3), _leg(-0.4, -0.3), _leg(0.4, -0.3)),
    "circle ahead, turning": (lambda t: (0.5 * cos(2 * pi * t), 0.5 * sin(2 * pi * t), 2 * pi, 0.0),),
    "circle sideways, turning": (lambda t: (-0.5 * sin(2 * pi * t), 0.5 * cos(2 * pi * t), 2 * pi, 0.0),),
}


@pytest.mark.parametrize("layout", ["same way", "mirrored"])
@pytest.mark.parametrize("path", PATHS)
def test_closed_paths_close(layout: str, path: str) -> None:
    pose = (0.0, 0.0, 0.0, 0.4)
    for leg in PATHS[path]:
        pose = drive(geometry(layout), pose, 1.0, leg)
    assert pose == pytest.approx((0.0, 0.0, 2 * pi if "turning" in path else 0.0, 0.4), abs=1e-6)


@every
@pytest.mark.parametrize("world", [(0.4, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 1.5), (0.3, -0.2, 1.0)])
def test_a_width_that_changes_does_not_move_the_middle(layout: str, world: Rates) -> None:
    """Along x, along y, turning, and all at once: the pose is what it is at a constant width."""
    vx, vy, wz = world
    still = drive(geometry(layout), (0.0, 0.0, 0.0, 0.4), 1.0, lambda _: (vx, vy, wz, 0.0))
    changing = drive(geometry(layout), (0.0, 0.0, 0.0, 0.4), 1.0, lambda t: (vx, vy, wz, 0.15 * cos(3.0 * t)))
    assert changing[:3] == pytest.approx(still[:3], abs=1e-9)
    assert changing[3] == pytest.approx(0.4 + 0.05 * sin(3.0), abs=1e-6)
    assert still[3] == pytest.approx(0.4, abs=1e-9)


# any number of wheels


def test_the_usual_four_by_hand() -> None:
    """Half lengths of 0.2 and 0.15 m, wheels of 0.05 m: vx -+ vy -+ (0.2 + 0.15) wz over the radius."""
    a = pi / 4.0
    chassis = mecanum_kinematics(
        [
            MecanumWheel(0.2, 0.15, -a, 0.05),
            MecanumWheel(0.2, -0.15, a, 0.05),
            MecanumWheel(-0.2, 0.15, a, 0.05),
            MecanumWheel(-0.2, -0.15, -a, 0.05),
        ]
    )
    lever = 0.35
    want = [(1, -1, -lever), (1, 1, lever), (1, 1, -lever), (1, -1, lever)]
    assert 0.05 * np.array(chassis.matrix()) == pytest.approx(np.array(want), abs=1e-15)


def test_a_tangent_is_that_of_the_angle() -> None:
    assert roller_tangent(pi / 4.0) == pytest.approx(1.0, abs=1e-15)
    assert roller_tangent(radians(-60.0)) == pytest.approx(-(3.0**0.5), abs=1e-15)
    assert roller_tangent(0.0) == 0.0
