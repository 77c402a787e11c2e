"""The robot from above: what is drawn is the wheel matrix, read back from the file and held against tables by hand."""

from collections.abc import Mapping
from math import atan2, cos, degrees, hypot, pi, radians, sin
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as Xml

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.font_manager import FontProperties
from matplotlib.image import imread
from matplotlib.textpath import TextPath

from gateway.chassis import CHASSIS, AnyRobot
from gateway.chassis.contract import Chassis, Drawing
from gateway.chassis.mecanum import MecanumRobot
from gateway.chassis.odd import OddRobot
from gateway.chassis.omni import OmniRobot
from gateway.cli.check import PICTURES
from gateway.cli.picture import _FORMS, draw, svg
from gateway.config import load, parse
from gateway.kinematics.contract import GeometryError
from gateway.robot_files import bundled
from gateway.setup.picture import BLACK, BLUE, GREEN, STYLES, VERMILION, Sheet, from_above
from gateway.setup.signs import JointSign, WheelSign, signs
from gateway.types import PLANAR
from tests.chassis_figures import SHOWN, figure, place
from tests.setup_robots import TRUE

FONT = FontProperties(family="DejaVu Sans")
SVG = "{http://www.w3.org/2000/svg}"
ROBOTS: dict[str, AnyRobot] = {name: load(path)[0].robot for name, path in bundled().items()} | {
    name: parse(text(), name).robot for name, text in TRUE.items()
}
every = pytest.mark.parametrize("name", ROBOTS)

Place = tuple[float, float]


class Seen(NamedTuple):
    """What is in a picture: lines by style and what they are of, taken back to m by its own axes and scale bar."""

    lines: Mapping[tuple[str, str], list[list[Place]]]
    words: list[str]

    def ways(self, style: str, of: str) -> list[float]:
        """Directions of these lines, degrees from forward to the left."""
        return [degrees(atan2(b[1] - a[1], b[0] - a[0])) for a, *_, b in self.lines[style, of]]


def seen(robot: Chassis) -> Seen:
    """By a reader that knows nothing of how it was drawn but the names of styles."""
    root = Xml.fromstring(svg(from_above(robot)))
    found: dict[tuple[str, str], list[list[Place]]] = {}
    for line in root.iter(f"{SVG}polyline"):
        points = [(float(x), float(y)) for x, y in (pair.split(",") for pair in line.attrib["points"].split())]
        found.setdefault((line.attrib["class"], line.attrib.get("data-of", "")), []).append(points)
    words = [str(text.text) for text in root.iter(f"{SVG}text")]
    (bar,) = found["axis", "scale"]
    label = [text for text in words if text.endswith(" m") and text.split()[0].replace(".", "").isdigit()][-1]
    scale = float(label.split()[0]) / (bar[2][0] - bar[1][0])
    (forward,), (left,) = found["axis", "x"], found["axis", "y"]
    assert forward[1][0] == forward[0][0]
    assert forward[1][1] < forward[0][1], "x is up on the paper"
    assert left[1][1] == left[0][1]
    assert left[1][0] < left[0][0], "y is to the left on the paper"
    middle = forward[0]
    lines = {
        key: [[(scale * (middle[1] - y), scale * (middle[0] - x)) for x, y in line] for line in drawn]
        for key, drawn in found.items()
    }
    return Seen(lines, words)


def apart(one: float, other: float, turn: float = 360.0) -> float:
    """Of two directions, degrees; of lines with a turn of 180."""
    return abs((one - other + turn / 2) % turn - turn / 2)


# By hand, degrees from forward to the left: where each wheel rolls that turns positively, the line on which its rollers
# let it slide, and how the rollers on top of it lie. An omni wheel rolls a quarter turn to the left of its axle, which
# points outward, so all of them together turn the robot counter-clockwise; it slides along its axle. A mecanum wheel
# rolls forward; of the X layout the rollers on top point to the middle of the robot, and the wheel slides along these
# where they have 45 degrees.
BY_HAND: dict[str, dict[str, tuple[float, float | None, float | None]]] = {
    "omni4": {
        "front_left": (150.0, 60.0, None),
        "rear_left": (-150.0, 120.0, None),
        "rear_right": (-30.0, 60.0, None),
        "front_right": (30.0, 120.0, None),
    },
    "kiwi": {"front": (90.0, 0.0, None), "rear_left": (-150.0, 120.0, None), "rear_right": (-30.0, 60.0, None)},
    "mecanum4": {
        "front_left": (0.0, 45.0, 45.0),
        "rear_left": (0.0, -45.0, -45.0),
        "rear_right": (0.0, 45.0, 45.0),
        "front_right": (0.0, -45.0, -45.0),
    },
    "odd": {
        "outer_left": (0.0, -45.0, -45.0),
        "inner_left": (0.0, 45.0, 45.0),
        "inner_right": (0.0, -45.0, -45.0),
        "outer_right": (0.0, 45.0, 45.0),
    },
    "moby": {"left": (0.0, None, None), "right": (0.0, None, None)},
}


def test_there_is_a_table_for_every_chassis() -> None:
    assert {ROBOTS[name].kind for name in BY_HAND} == set(CHASSIS) == set(SHOWN)


@pytest.mark.parametrize("name", BY_HAND)
def test_the_arrows_by_hand(name: str) -> None:
    picture = seen(ROBOTS[name])
    assert {of for style, of in picture.lines if style == "rolls" and of} == set(BY_HAND[name])
    for motor, (way, line, top) in BY_HAND[name].items():
        (rolls,) = picture.ways("rolls", motor)
        assert apart(rolls, way) < 1.0, motor
        assert (("slides", motor) in picture.lines) == (line is not None)
        for slides in picture.ways("slides", motor) if line is not None else ():
            assert apart(slides, line or 0.0, 180.0) < 1.0, motor
        assert (("roller", motor) in picture.lines) == (top is not None)
        for roller in picture.ways("roller", motor) if top is not None else ():
            assert apart(roller, top or 0.0, 180.0) < 2.0, motor


@every
def test_the_arrows_are_the_wheel_matrix(name: str) -> None:
    """A body that moves along the arrow turns the wheel positively, v / r; along the line, not at all."""
    robot = ROBOTS[name]
    picture, kinematics = seen(robot), robot.kinematics()
    wheels = iter(robot.drawing().wheels)
    for at, motor in enumerate(robot.motor_names()):
        if at == robot.drawing().beneath:
            continue
        wheel = next(wheels)
        (line,) = picture.lines["rolls", motor]
        assert line[0] == pytest.approx((wheel.x, wheel.y), abs=1e-3), "to scale, in its place"

        def speed(degrees_left: float, at: int = at) -> float:
            way = radians(degrees_left)
            rates = (cos(way), sin(way), *[0.0] * (len(robot.AXES) - 2))
            speeds = kinematics.wheel_speeds(rates, [0.0] * len(robot.motor_names()))
            assert speeds is not None
            return speeds[at]

        (rolls,) = picture.ways("rolls", motor)
        assert speed(rolls) * wheel.radius == pytest.approx(1.0, abs=0.02)
        for slides in picture.ways("slides", motor) if robot.drawing().rollers else ():
            assert speed(slides) * wheel.radius == pytest.approx(0.0, abs=0.02)


class Reversed(OmniRobot):
    """Its drawing has every wheel the other way round, which is the same wheel."""

    def drawing(self) -> Drawing:
        drawing = super().drawing()
        return drawing._replace(wheels=tuple(one._replace(rolling=one.rolling + pi) for one in drawing.wheels))


def test_the_matrix_decides_and_not_the_drawing() -> None:
    robot = ROBOTS["omni4"]
    drawn = [sign.way for sign in signs(robot) if isinstance(sign, WheelSign)]
    reversed_ = [sign.way for sign in signs(Reversed(**dict(robot))) if isinstance(sign, WheelSign)]
    for one, other in zip(drawn, reversed_, strict=True):
        assert other == pytest.approx(one)


def test_the_joint_turns_the_body_counter_clockwise() -> None:
    """By hand: a platform that turns to the left above a chassis at rest has a positive joint speed."""
    (arc,) = seen(ROBOTS["moby"]).lines["turns", "platform"]
    turned = [atan2(y, x) for x, y in arc]
    assert turned == sorted(turned)
    speeds = ROBOTS["moby"].kinematics().wheel_speeds((0.0, 0.0, 1.0), [0.0, 0.0, 0.0])
    assert speeds == pytest.approx([0.0, 0.0, 1.0])


def test_the_widths_of_the_odd() -> None:
    robot = ROBOTS["odd"]
    assert isinstance(robot, OddRobot)
    picture = seen(robot)
    for key, metres in (("narrowest", 0.25), ("width", 0.4), ("widest", 0.6)):
        line = picture.lines["length", key][0]
        assert hypot(line[1][0] - line[0][0], line[1][1] - line[0][1]) == pytest.approx(metres, abs=2e-3)
        assert f"{key} {metres:g} m" in picture.words
    apart_ways = [round(way) for way in picture.ways("more", "width_rate")]
    assert apart_ways == [90, 90, -90, -90], "a positive rate takes the pairs apart"


@every
def test_every_chassis_of_the_registry_can_be_drawn(name: str) -> None:
    robot = ROBOTS[name]
    picture, told = seen(robot), signs(robot)
    assert tuple(sign.motor for sign in told) == robot.motor_names()
    for number, sign in enumerate(told, start=1):
        assert str(number) in picture.words
        assert any(text.startswith(f"{sign.motor}: ") for text in picture.words)
        assert ("turns" if isinstance(sign, JointSign) else "rolls", sign.motor) in picture.lines
    axes = robot.AXES[len(PLANAR) :]
    assert {of for style, of in picture.lines if style == "more"} - {""} == set(axes), "each axis beyond the twist"
    legend = {style for style, of in picture.lines if of == "" and f"{style}_head" in STYLES}
    assert legend == {style for style, of in picture.lines if of and f"{style}_head" in STYLES} - {"axis"}
    assert any("setup directions" in text for text in picture.words)


def test_a_name_may_be_as_long_as_it_may_be() -> None:
    robot = ROBOTS["moby"].model_copy(update={"platform": "platform_of_the_robot_in_front_1"})
    assert_within(from_above(robot))


@every
def test_nothing_is_outside_the_paper(name: str) -> None:
    assert_within(from_above(ROBOTS[name]))


@pytest.mark.parametrize(("reach", "radius", "count"), [(10.0, 0.001, 16), (0.01, 0.3, 3), (0.2, 0.05, 16)])
def test_any_size_has_its_place(reach: float, radius: float, count: int) -> None:
    """Arrows keep their length, and the legend has a line for every motor."""
    wheels = [
        {"motor": f"m{at}", "x": reach * cos(angle), "y": reach * sin(angle), "axis_angle": angle, "radius": radius}
        for at, angle in ((at, 2.0 * pi * at / count - pi) for at in range(count))
    ]
    given = {"kind": "omni", "name": "any", "body": {"mass": 20.0, "inertia": 1.0}, "wheel": wheels}
    sheet = from_above(OmniRobot.model_validate(given))
    assert_within(sheet)
    arrows = [mark.points for mark in sheet.marks if mark.style == "rolls" and mark.of]
    assert len(arrows) == count
    assert all(hypot(b[0] - a[0], b[1] - a[1]) > 20.0 for a, b in arrows)


def assert_within(sheet: Sheet) -> None:
    for mark in sheet.marks:
        assert all(0.0 <= x <= sheet.width and 0.0 <= y <= sheet.height for x, y in mark.points), mark.style
    for words in sheet.words:
        # A size of 10 is one of 10 units there. Fonts that stand in for this one are up to a tenth wider.
        width = TextPath((0.0, 0.0), words.text, size=words.size, prop=FONT).get_extents().width * 1.1
        left = words.at[0] - (0.5 * width if words.middle else 0.0)
        assert left >= 0.0
        assert left + width <= sheet.width, words.text


ANGLES = st.floats(-pi, pi)
OMNI = st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), ANGLES), min_size=3, max_size=6)


@given(OMNI, st.sampled_from([0.02, 0.1, 0.5]))
@settings(max_examples=50, deadline=None)
def test_any_omni_robot_rolls_where_its_matrix_says(poses: list[tuple[float, float, float]], radius: float) -> None:
    given = {"kind": "omni", "name": "any", "body": {"mass": 20.0, "inertia": 1.0}}
    wheels = [
        {"motor": f"m{at}", "x": x, "y": y, "axis_angle": angle, "radius": radius}
        for at, (x, y, angle) in enumerate(poses)
    ]
    robot = OmniRobot.model_validate(given | {"wheel": wheels})
    try:
        told = signs(robot)
    except GeometryError:
        return
    for sign, (_, _, angle) in zip(told, poses, strict=True):
        assert isinstance(sign, WheelSign)
        assert sign.way == pytest.approx((-sin(angle), cos(angle)), abs=1e-9)
        assert sign.roller == pytest.approx(sign.way, abs=1e-9)


@given(st.floats(0.1, 1.4), st.sampled_from([1.0, -1.0]))
def test_any_mecanum_robot_holds_the_floor_along_its_rollers(angle: float, side: float) -> None:
    robot = ROBOTS["mecanum4"]
    assert isinstance(robot, MecanumRobot)
    wheels = [
        wheel.model_copy(update={"roller_angle": side * angle * (1.0 if wheel.roller_angle > 0.0 else -1.0)})
        for wheel in robot.wheel
    ]
    turned = robot.model_copy(update={"wheel": wheels})
    try:
        told = signs(turned)
    except GeometryError:  # of a square in which every roller points past the middle
        return
    for sign, wheel in zip(told, wheels, strict=True):
        assert isinstance(sign, WheelSign)
        assert sign.way == (1.0, 0.0)
        assert sign.roller == pytest.approx((cos(wheel.roller_angle), sin(wheel.roller_angle)), abs=1e-9)


@pytest.mark.parametrize("kind", CHASSIS)
def test_the_figures_of_the_documentation_are_up_to_date(kind: str) -> None:
    """`python -m tests.chassis_figures` writes them anew."""
    assert place(kind).read_text(encoding="utf-8") == figure(kind)


def test_a_pixel_picture_shows_the_same(tmp_path: Path) -> None:
    """Two pixels to a px of the sheet: at the tip of each arrow is its colour."""
    sheet = from_above(ROBOTS["odd"])
    draw(ROBOTS["odd"], tmp_path / "odd.PNG")
    pixels = imread(tmp_path / "odd.PNG")
    assert pixels.shape[:2] == (round(2 * sheet.height), round(2 * sheet.width))
    heads = [mark for mark in sheet.marks if mark.style in ("rolls_head", "slides_head", "more_head")]
    assert len(heads) == 4 + 8 + 4 + 4
    for head in heads:
        x, y = (sum(point[axis] for point in head.points) / 3 for axis in (0, 1))
        red, green, blue = (round(255 * float(part)) for part in pixels[round(2 * y), round(2 * x)][:3])
        assert f"#{red:02X}{green:02X}{blue:02X}" == STYLES[head.style].fill


def test_colours_stay_apart_for_colour_blind_eyes() -> None:
    """Of Okabe and Ito's set; and what has the same colour has another line."""
    assert {BLUE, VERMILION, GREEN, BLACK} <= {style.stroke for style in STYLES.values()}
    arrows = [STYLES[name] for name in ("rolls", "slides", "turns", "more", "axis")]
    assert len({(style.stroke, style.dash, style.width) for style in arrows}) == len(arrows)
    assert set(_FORMS) == set(PICTURES)
