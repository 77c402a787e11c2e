"""Paths of lines, arcs and clothoids: geometry against 30-digit integrals, the file, the rules of pulled driving."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpf

from gateway.config import ConfigError
from gateway.paths import path_file
from gateway.paths.path import Path, Piece
from gateway.paths.rules import joined_on_axle, problems, start_error, start_problem
from gateway.types import Pose
from tests.pulled import PulledRobot

ORIGIN = Pose(0.0, 0.0, 0.0)
D1 = 0.145

FIGURE_9 = """
[[piece]]
kind = "arc"
radius = 5.0
angle = 1.0471975511965976
[[piece]]
kind = "arc"
radius = 8.0
angle = 1.5707963267948966
[[piece]]
kind = "line"
length = 5.0
"""


def piece_of(before: float, after: float, length: float) -> Path:
    return Path(ORIGIN, [Piece("clothoid", length, before, after)])


@settings(max_examples=60, deadline=None)
@given(st.floats(-7.0, 7.0), st.floats(-7.0, 7.0), st.floats(1e-3, 5.0))
def test_a_clothoid_ends_where_the_integral_says(before: float, after: float, length: float) -> None:
    """Within 2e-14 of its length; the heading is the square of the way itself."""
    end = piece_of(before, after, length).at(length)
    with mp.workdps(30):
        slope = (mpf(after) - mpf(before)) / mpf(length)
        turns = max(2, round(max(abs(before), abs(after)) * length))
        x = mp.quad(lambda s: mp.cos(s * (before + slope * s / 2)), mp.linspace(0, mpf(length), turns + 1))
        y = mp.quad(lambda s: mp.sin(s * (before + slope * s / 2)), mp.linspace(0, mpf(length), turns + 1))
    assert abs(end.x - x) <= 2e-14 * length + 1e-16
    assert abs(end.y - y) <= 2e-14 * length + 1e-16
    assert end.heading == pytest.approx(0.5 * (before + after) * length, abs=1e-13)


def test_fresnel_by_heart() -> None:
    """The clothoid with curvature pi s: C(1) = 0.7798934003768228, S(1) = 0.4382591473903548."""
    end = piece_of(0.0, math.pi, 1.0).at(1.0)
    assert (end.x, end.y) == pytest.approx((0.7798934003768228, 0.4382591473903548), abs=1e-15)


@settings(max_examples=60, deadline=None)
@given(st.floats(-5.0, 5.0).filter(lambda k: abs(k) > 1e-3), st.floats(0.01, 5.0), st.floats(0.0, 1.0))
def test_an_arc_is_a_circle(curvature: float, length: float, share: float) -> None:
    point = piece_of(curvature, curvature, length).at(share * length)
    angle = curvature * share * length
    assert point.x == pytest.approx(math.sin(angle) / curvature, abs=1e-12)
    assert point.y == pytest.approx((1.0 - math.cos(angle)) / curvature, abs=1e-12)


def test_figure_9_from_its_file() -> None:
    """22.802 m; it ends 150 degrees to the left: the sum of its chords by hand."""
    path = path_file.parse(FIGURE_9, "figure9.toml")
    assert path.length == pytest.approx(22.802, abs=5e-4)
    end = path.at(path.length)
    assert end.heading == pytest.approx(math.radians(150.0))
    x = 5.0 * math.sin(math.pi / 3) + 8.0 * (math.sin(5 * math.pi / 6) - math.sin(math.pi / 3)) - 2.5 * math.sqrt(3.0)
    y = 5.0 * 0.5 + 8.0 * (0.5 - math.cos(5 * math.pi / 6)) + 2.5
    assert (end.x, end.y) == pytest.approx((x, y))
    assert path.sharpest == pytest.approx(0.2)


def test_before_and_behind_a_path() -> None:
    path = path_file.parse(FIGURE_9, "figure9.toml")
    assert path.at(-1.0) == path.at(0.0)
    end, beyond = path.at(path.length), path.at(path.length + 2.0)
    assert (beyond.x - end.x, beyond.y - end.y) == pytest.approx(
        (2.0 * math.cos(end.heading), 2.0 * math.sin(end.heading))
    )
    assert beyond.curvature == 0.0


@settings(max_examples=40, deadline=None)
@given(st.floats(0.5, 22.0), st.floats(-1.0, 1.0))
def test_the_nearest_point_of_a_place_beside_is_where_it_is_beside(way: float, aside: float) -> None:
    path = path_file.parse(FIGURE_9, "figure9.toml")
    point = path.at(way)
    x, y = point.x - aside * math.sin(point.heading), point.y + aside * math.cos(point.heading)
    assert path.nearest(x, y, between=(way - 1.0, way + 1.0)) == pytest.approx(way, abs=1e-9)
    assert path.beside(x, y, way) == pytest.approx((0.0, aside), abs=1e-12)


def test_a_clothoid_takes_the_curvatures_of_its_neighbours() -> None:
    text = """
    [start]
    x = 1.0
    heading = 1.5
    [[piece]]
    kind = "clothoid"
    length = 0.4
    [[piece]]
    kind = "arc"
    radius = 2.0
    angle = -1.0
    [[piece]]
    kind = "clothoid"
    length = 0.6
    [[piece]]
    kind = "line"
    length = 1.0
    """
    path = path_file.parse(text, "p.toml")
    assert [(piece.before, piece.after) for piece in path.pieces] == [
        (0.0, -0.5),
        (-0.5, -0.5),
        (-0.5, 0.0),
        (0.0, 0.0),
    ]
    assert path.at(0.0)[:3] == (1.0, 0.0, 1.5)
    ways = [0.001 * number for number in range(4000)]
    jumps = [abs(path.at(b).curvature - path.at(a).curvature) for a, b in pairwise(ways)]
    assert max(jumps) <= 0.001 * 0.5 / 0.4 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "piece"),
        ("piece = 3", "piece"),
        ("[[piece]]\nkind = 'spiral'", "line"),
        ("[[piece]]\nkind = 'line'\nlength = 0.0", "length"),
        ("[[piece]]\nkind = 'line'\nlength = nan", "length"),
        ("[[piece]]\nkind = 'line'\nlength = 1.0\nradius = 2.0", "radius"),
        ("[[piece]]\nkind = 'arc'\nradius = 1.0\nangle = 0.0", "an arc must turn"),
        ("[[piece]]\nkind = 'clothoid'\nlength = 1.0\n[[piece]]\nkind = 'clothoid'\nlength = 1.0", r"piece\[1\]"),
        ("[[piece", "not valid TOML"),
    ],
)
def test_what_a_path_file_must_not_say(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        path_file.parse(text, "p.toml")


def test_the_rules_name_the_place() -> None:
    text = """
    [[piece]]
    kind = "line"
    length = 2.0
    [[piece]]
    kind = "arc"
    radius = 0.1
    angle = 1.0
    [[piece]]
    kind = "corner"
    angle = 0.5
    """
    tight, corner = problems(path_file.parse(text, "p.toml"), D1)
    assert tight == "piece[1] (arc), 2.000 m from the start: radius 0.1 m: must be at least the axle offset, 0.145 m"
    assert corner.startswith("piece[2] (corner), 2.100 m from the start: turns by 0.5 rad at once")
    assert problems(path_file.parse(FIGURE_9, "f"), D1) == []
    assert problems(Path(ORIGIN, [Piece("arc", 1.0, 1.0 / D1, 1.0 / D1)]), D1) == []


def test_the_start_is_tangent_to_the_pull_direction() -> None:
    """Straight on: the chassis looks back. Into an arc: turned by asin(d1/R) (Eq. 22)."""
    line, arc = Path(ORIGIN, [Piece("line", 1.0, 0.0, 0.0)]), path_file.parse(FIGURE_9, "f")
    assert start_error(line, math.pi, D1) == pytest.approx(0.0, abs=1e-12)
    assert start_error(arc, math.asin(D1 / 5.0) - math.pi, D1) == pytest.approx(0.0, abs=1e-12)
    assert start_problem(line, math.pi + 0.04, D1) is None
    assert start_problem(line, math.pi + 0.06, D1) == (
        "start: -0.060 rad from the direction in which the chassis is pulled: must be within 0.05"
    )
    assert start_problem(line, 0.0, D1) is not None


def test_the_instant_centre_stays_on_the_axle() -> None:
    """Arcs joined by the turn of direction: no error of gamma arises where the curvature jumps, and none is corrected.

    Against it the same arcs joined tangent: there gamma is off by asin(d1 a) - asin(d1 b).
    """
    arcs = [
        Piece("a", 2.0, 0.2, 0.2),
        Piece("b", 2.0, 1.0, 1.0),
        Piece("c", 2.0, -0.5, -0.5),
        Piece("d", 1.0, 0.0, 0.0),
    ]
    errors = {}
    for name, path in (
        ("on axle", joined_on_axle(Path(ORIGIN, arcs, on_axle=True), D1)),
        ("tangent", Path(ORIGIN, arcs)),
    ):
        robot, h, worst = PulledRobot(D1, math.asin(0.2 * D1) - math.pi), 2e-4, 0.0
        for cycle in range(round(2.2 / h)):  # until a little behind the first joint: an error grows e-fold every d1
            point = path.at(h * (cycle + 0.5))
            gamma = point.heading - robot.heading
            goal = math.pi - math.asin(D1 * point.curvature)
            worst = max(worst, abs(math.remainder(gamma - goal, math.tau)))
            robot.move(math.cos(point.heading), math.sin(point.heading), h)
        errors[name] = worst
    jump = math.asin(D1) - math.asin(0.2 * D1)
    assert errors["tangent"] > 0.9 * jump
    assert errors["on axle"] < 0.2 * jump


def test_an_arc_tighter_than_d1_by_rounding_alone_is_joined_as_one_of_d1() -> None:
    """Rule 2 lets 1e-9 pass, and beyond 1 there is no arcsine: opposite arcs turn by pi between them."""
    radius = D1 * (1.0 - 1e-10)
    arcs = [Piece("left", 0.1, 1.0 / radius, 1.0 / radius), Piece("right", 0.1, -1.0 / radius, -1.0 / radius)]
    path = Path(ORIGIN, arcs, on_axle=True)
    assert not problems(path, D1)
    joined = joined_on_axle(path, D1)
    assert joined.pieces[1].corner == pytest.approx(math.pi)
    assert start_error(joined, math.pi / 2.0 - math.pi, D1) == pytest.approx(0.0)
