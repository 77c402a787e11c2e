"""The robot from above, to scale, with what every motor does when it turns positively: marks on a sheet of paper. Pure.

How this works
--------------
Everything on the robot is in m, x forward and y left; `_Ground` alone takes that to the paper, where forward is up and
left is left. The arrows come from `signs`, which reads the wheel matrix; places and lengths come from the drawing that
every chassis gives. Where a mark is on the paper is in px, x to the right and y down.
"""

from collections.abc import Sequence
from math import pi, sqrt
from textwrap import wrap
from typing import Final, NamedTuple

from gateway.arithmetic import dot, sin_cos
from gateway.chassis.contract import Chassis, Drawing, DrawnLength, Point
from gateway.setup.signs import JointSign, WheelSign, signs
from gateway.setup.words import UNSEEN, positive_ways
from gateway.types import PLANAR

WIDTH: Final = 720.0  # px
_ROOM: Final = (560.0, 400.0)  # px across and upwards, that the robot has at most
_EDGE: Final = 40.0
_LINE: Final = 22.0  # px from a line of words to the next
_TOP: Final = 80.0  # of the title
_SAMPLE: Final = 56.0  # px, width of what the legend explains
_HALF_WIDTH: Final = 0.3  # of a wheel, in radii
_ARROW: Final = 1.75  # of the arrow of a wheel, in radii from its middle
_LEAST: Final = 22.0  # px, of a radius: the arrows of smaller wheels are not smaller
_SLIDE: Final = 1.35
_ASIDE: Final = 0.6
_STRIPES: Final = (-0.75, -0.375, 0.0, 0.375, 0.75)  # where rollers are drawn, in radii along the wheel
_HEAD: Final = 11.0  # px of an arrow's head
_BADGE: Final = 11.0  # px, radius of the circle around a number
_TURN: Final = (0.15 * pi, 0.42 * pi)  # rad from forward to the left, from where to where the arrow of a joint goes
_ROUND_STEPS: Final = 48
_ARROW_STEPS: Final = 8  # each longer than the head
_LETTERS: Final = 78  # in a line
_ALONG: Final = 0.2  # of a unit vector: less of it is hardly any
_ROUND: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # m


class Style(NamedTuple):
    """How lines or areas look; "" is nothing. The colours are those of Okabe and Ito: colour-blind eyes tell them."""

    stroke: str = ""
    width: float = 1.0
    fill: str = ""
    dash: tuple[float, ...] = ()


BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
BLACK: Final = "#000000"
GREY: Final = "#595959"
STYLES: Final[dict[str, Style]] = {
    "paper": Style(fill="#FFFFFF"),
    "body": Style(GREY, 1.2, dash=(2.0, 3.0)),
    "frame": Style(GREY, 1.6, "#F2F2F2"),
    "wheel": Style(BLACK, 1.4, "#DDDDDD"),
    "roller": Style(GREY, 2.2),
    "rolls": Style(BLUE, 4.0),
    "rolls_head": Style(BLUE, 1.0, BLUE),
    "slides": Style(VERMILION, 2.0, dash=(6.0, 4.0)),
    "slides_head": Style(VERMILION, 1.0, VERMILION),
    "turns": Style(GREEN, 4.0),
    "turns_head": Style(GREEN, 1.0, GREEN),
    "more": Style(GREEN, 3.0, dash=(2.0, 2.0)),
    "more_head": Style(GREEN, 1.0, GREEN),
    "axis": Style(BLACK, 1.2),
    "axis_head": Style(BLACK, 1.0, BLACK),
    "joint": Style(BLACK, 1.4, "#FFFFFF"),
    "length": Style(GREY, 1.0),
    "badge": Style(BLACK, 1.2, "#FFFFFF"),
}


class Mark(NamedTuple):
    """A line through these points, or where it is closed an area. `of`: the motor or axis it is about, "" of none."""

    style: str
    points: tuple[Point, ...]
    closed: bool = False
    of: str = ""


class Words(NamedTuple):
    """Beginning at this place, or around it where `middle`."""

    text: str
    at: Point
    middle: bool = False
    strong: bool = False
    size: float = 14.0


class Sheet(NamedTuple):
    """A picture; `title` and `says` are for who does not see it."""

    title: str
    says: str
    width: float
    height: float
    marks: tuple[Mark, ...]
    words: tuple[Words, ...]


class _Paper:
    """What is on the sheet so far. Places are px."""

    def __init__(self) -> None:
        self.marks: list[Mark] = []
        self.words: list[Words] = []

    def line(self, style: str, *points: Point, of: str = "") -> None:
        self.marks.append(Mark(style, points, of=of))

    def area(self, style: str, *points: Point, of: str = "") -> None:
        self.marks.append(Mark(style, points, closed=True, of=of))

    def circle(self, style: str, middle: Point, radius: float) -> None:
        self.area(style, *_arc(middle, radius, 0.0, 2.0 * pi, steps=_ROUND_STEPS))

    def arrow(self, style: str, *points: Point, of: str = "") -> None:
        """A line with a head at its end, which is of the style with this name and _head."""
        tip = points[-1]
        ahead = _unit(_minus(tip, points[-2]))
        neck = _moved(tip, ahead, -_HEAD)
        side = (-ahead[1], ahead[0])
        self.line(style, *points[:-1], neck, of=of)
        self.area(f"{style}_head", tip, _moved(neck, side, 0.5 * _HEAD), _moved(neck, side, -0.5 * _HEAD), of=of)

    def say(self, text: str, at: Point, *, middle: bool = False, strong: bool = False, size: float = 14.0) -> None:
        self.words.append(Words(text, at, middle, strong, size))


class _Ground:
    """From the robot to the paper: forward is up, left is left."""

    def __init__(self, robot: Sequence[Point]) -> None:
        """`robot`: places that have to be seen, m."""
        front, rear = max(x for x, _ in robot), min(x for x, _ in robot)
        left, right = max(y for _, y in robot), min(y for _, y in robot)
        self.scale = min(_ROOM[0] / (left - right), _ROOM[1] / (front - rear))  # px per m
        self.bottom = _TOP + self.scale * (front - rear)
        self._middle = (0.5 * WIDTH + 0.5 * self.scale * (left + right), _TOP + self.scale * front)

    def at(self, place: Point) -> Point:
        """Of a place, m."""
        x, y = place
        return self._middle[0] - self.scale * y, self._middle[1] - self.scale * x

    def all(self, places: Sequence[Point]) -> tuple[Point, ...]:
        """Of several."""
        return tuple(map(self.at, places))


def from_above(robot: Chassis) -> Sheet:
    """Raises GeometryError."""
    told, drawing = signs(robot), robot.drawing()
    ground, paper = _Ground(_extent(drawing, told)), _Paper()
    _body(paper, ground, drawing)
    for sign in told:
        if isinstance(sign, WheelSign):
            _wheel(paper, ground, sign)
    for length in drawing.lengths:
        _length(paper, ground, length)
    _axes(paper, ground, drawing.reach)
    for number, sign in enumerate(told, start=1):
        if isinstance(sign, WheelSign):
            _wheel_signs(paper, ground, sign, robot.AXES[len(PLANAR) :], str(number))
        else:
            _joint(paper, ground, sign, drawing.reach, str(number))
    _scale_bar(paper, ground)
    ways = [f"{motor}: {way}" for motor, way in positive_ways(robot).items()]
    bottom = _legend(paper, ground.bottom + 3.5 * _LINE, ways, robot)
    title = f"{robot.name} ({robot.kind}) from above"
    paper.say(title, (_EDGE, 34.0), strong=True, size=19.0)
    paper.say("What each motor does when it turns positively. x is forward, y to the left; to scale.", (_EDGE, 58.0))
    white = Mark("paper", ((0.0, 0.0), (WIDTH, 0.0), (WIDTH, bottom), (0.0, bottom)), closed=True)
    return Sheet(title, "; ".join(ways), WIDTH, bottom, (white, *paper.marks), tuple(paper.words))


def _extent(drawing: Drawing, told: Sequence[WheelSign | JointSign]) -> list[Point]:
    """What has to have room, m."""
    reach = drawing.reach if drawing.beneath is not None else 0.0
    found = [(reach, reach), (-reach, -reach), *drawing.frame]
    for length in drawing.lengths:
        found += [length.start, length.end]
    for sign in told:
        if isinstance(sign, WheelSign):
            x, y, _, radius = sign.wheel
            room = (_ARROW + 0.1) * radius
            found += [(x + room, y + room), (x - room, y - room)]
    return found


def _body(paper: _Paper, ground: _Ground, drawing: Drawing) -> None:
    """What turns on the joint is dotted, what carries it drawn through."""
    if drawing.frame:
        paper.area("frame", *ground.all(drawing.frame[:-1]))
    if drawing.beneath is not None:
        paper.circle("body", ground.at((0.0, 0.0)), ground.scale * drawing.reach)


def _wheel(paper: _Paper, ground: _Ground, sign: WheelSign) -> None:
    """With the rollers on top of it, as they are seen from above: mirrored to the one on the floor."""
    x, y, _, radius = sign.wheel
    along = sign.wheel.along
    across, half = (-along[1], along[0]), _HALF_WIDTH * radius

    def corner(ahead: float, aside: float) -> Point:
        return ground.at(_moved(_moved((x, y), along, ahead), across, aside))

    paper.area("wheel", *(corner(a * radius, b * half) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))), of=sign.motor)
    if sign.roller is None:
        return
    ahead, aside = dot(sign.roller, along), -dot(sign.roller, across)
    if abs(aside) < _ALONG:
        return  # of an omni wheel: along the wheel
    for share in _STRIPES:
        size = min(half / abs(aside), (1.0 - abs(share)) * radius / max(abs(ahead), _ALONG))
        ends = (corner(share * radius + s * size * ahead, s * size * aside) for s in (1.0, -1.0))
        paper.line("roller", *ends, of=sign.motor)


def _wheel_signs(paper: _Paper, ground: _Ground, sign: WheelSign, more: Sequence[str], number: str) -> None:
    """Where it rolls, where it slides, and where the axes beyond the twist move it; its number stands at its rear."""
    here, radius = (sign.wheel.x, sign.wheel.y), max(sign.wheel.radius, _LEAST / ground.scale)
    if sign.roller is not None:
        free = (-sign.roller[1], sign.roller[0])
        for way in (1.0, -1.0):
            paper.arrow("slides", *ground.all((here, _moved(here, free, way * _SLIDE * radius))), of=sign.motor)
    paper.arrow("rolls", *ground.all((here, _moved(here, sign.way, _ARROW * radius))), of=sign.motor)
    behind = _moved(here, sign.way, -1.25 * radius)
    for axis, share in zip(more, sign.more, strict=True):
        if share != 0.0:
            paper.arrow("more", *ground.all((behind, _moved(behind, (0.0, share), 1.2 * radius))), of=axis)
    _badge(paper, ground.at(_moved(here, sign.way, -0.68 * radius)), number)


def _joint(paper: _Paper, ground: _Ground, sign: JointSign, reach: float, number: str) -> None:
    """On the rim of the body, which turns."""
    middle, radius = ground.at((0.0, 0.0)), ground.scale * reach
    paper.circle("joint", middle, 6.0)
    first, last = _TURN if sign.turns > 0.0 else (_TURN[1], _TURN[0])
    # From forward, counter-clockwise: on the paper forward is at -90 degrees, and angles grow clockwise.
    paper.arrow("turns", *_arc(middle, radius, -0.5 * pi - first, -0.5 * pi - last, steps=_ARROW_STEPS), of=sign.motor)
    s, c = sin_cos(0.5 * (first + last))
    _badge(paper, ground.at((reach * c, reach * s)), number)


def _axes(paper: _Paper, ground: _Ground, reach: float) -> None:
    """The robot's frame."""
    size = 0.35 * reach
    for axis, tip, shift in (("x", (size, 0.0), (0.0, -8.0)), ("y", (0.0, size), (-14.0, 5.0))):
        paper.arrow("axis", *ground.all(((0.0, 0.0), tip)), of=axis)
        at = ground.at(tip)
        paper.say(axis, (at[0] + shift[0], at[1] + shift[1]), middle=True, strong=True)


def _length(paper: _Paper, ground: _Ground, length: DrawnLength) -> None:
    """Its words are beside its middle."""
    start, end = ground.all((length.start, length.end))
    ahead = _unit(_minus(end, start))
    tick = (-6.0 * ahead[1], 6.0 * ahead[0])
    paper.line("length", start, end, of=length.key)
    for place in (start, end):
        paper.line("length", _moved(place, tick, 1.0), _moved(place, tick, -1.0), of=length.key)
    dx, dy = _minus(length.end, length.start)
    metres = f"{sqrt(dx * dx + dy * dy):.4g} m"
    x, y = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
    if abs(ahead[0]) > abs(ahead[1]):
        paper.say(f"{length.key} {metres}", (x, y + 15.0), middle=True, size=12.0)
    else:
        paper.say(length.key, (x + 8.0, y - 4.0), size=12.0)
        paper.say(metres, (x + 8.0, y + 12.0), size=12.0)


def _badge(paper: _Paper, at: Point, number: str) -> None:
    paper.circle("badge", at, _BADGE)
    paper.say(number, (at[0], at[1] + 5.0), middle=True, strong=True)


def _scale_bar(paper: _Paper, ground: _Ground) -> None:
    """The longest round length that is at most a quarter of the picture."""
    metres = max(size for size in _ROUND if size * ground.scale <= 0.25 * WIDTH)
    left, y = _EDGE, ground.bottom + 2.0 * _LINE
    right = left + metres * ground.scale
    paper.line("axis", (left, y - 5.0), (left, y), (right, y), (right, y - 5.0), of="scale")
    paper.say(f"{metres:g} m", (right + 10.0, y + 4.0))


def _legend(paper: _Paper, top: float, ways: Sequence[str], robot: Chassis) -> float:
    """In words what is seen, and what each motor does; where it ends."""
    y = top
    for number, way in enumerate(ways, start=1):
        _badge(paper, (_EDGE + _BADGE, y), str(number))
        y = _told(paper, way, _EDGE + 2.0 * _BADGE + 14.0, y) + 4.0
    y += 0.4 * _LINE
    seen = {mark.style for mark in paper.marks}
    for style, words in _explained(robot):
        if style not in seen:
            continue
        _sample(paper, style, y)
        y = _told(paper, words, _EDGE + _SAMPLE + 14.0, y)
    return _told(paper, UNSEEN.format(file="FILE"), _EDGE, y + 0.4 * _LINE) + 0.5 * _LINE


def _told(paper: _Paper, text: str, left: float, y: float) -> float:
    """In as many lines as it takes; where the next one is."""
    for line in wrap(text, _LETTERS):
        paper.say(line, (left, y + 5.0))
        y += _LINE
    return y


def _sample(paper: _Paper, style: str, y: float) -> None:
    left, right = (_EDGE, y), (_EDGE + _SAMPLE, y)
    if f"{style}_head" in STYLES:
        paper.arrow(style, left, right)
        if style == "slides":
            paper.arrow(style, right, left)
    elif style == "roller":
        for place in (0.2, 0.5, 0.8):
            paper.line(style, (_EDGE + place * _SAMPLE - 6.0, y + 6.0), (_EDGE + place * _SAMPLE + 6.0, y - 6.0))
    else:
        paper.line(style, left, right)


def _explained(robot: Chassis) -> list[tuple[str, str]]:
    """By style, in the order of the legend."""
    more = " and ".join(robot.AXES[len(PLANAR) :])
    return [
        ("rolls", "turned positively, the wheel rolls this way over the floor"),
        ("slides", "its rollers let it slide along this line, both ways alike"),
        (
            "roller",
            "its rollers as you see them from above, on top of it; the one on the floor lies mirrored",
        ),
        ("turns", "turned positively, the joint turns the body this way on what carries it"),
        ("more", f"a positive {more} moves the wheel this way"),
        ("body", "the body, which turns on the joint"),
    ]


def _arc(middle: Point, radius: float, first: float, last: float, *, steps: int) -> tuple[Point, ...]:
    """On paper, rad from the right, clockwise."""
    found = []
    for step in range(steps + 1):
        s, c = sin_cos(first + (last - first) * step / steps)
        found.append((middle[0] + radius * c, middle[1] + radius * s))
    return tuple(found)


def _moved(place: Point, way: Point, by: float) -> Point:
    return place[0] + by * way[0], place[1] + by * way[1]


def _minus(one: Point, other: Point) -> Point:
    return one[0] - other[0], one[1] - other[1]


def _unit(way: Point) -> Point:
    size = sqrt(dot(way, way))
    return way[0] / size, way[1] / size
