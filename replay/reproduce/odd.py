"""Figures 8 to 11 of arXiv 2412.10773: four paths, the width changed in motion, and a course with narrow passages.

A form of the robot that is added to `FORMS` drives figures 8, 10 and 11 too.
"""

from collections.abc import Sequence
from math import cos, degrees, hypot, inf, pi, sin, sqrt
from typing import Final, NamedTuple

from gateway.types import Pose
from replay.reproduce.odd_robot import (
    BALANCING,
    CASTERS,
    LEVEL,
    PAPER_NOTE,
    TILTED,
    Course,
    Form,
    Leg,
    Rates,
    Seen,
    apart,
    drive_odd,
    ideal,
    one_by_one,
    robot_of,
)
from replay.reproduce.picture import Line, Mark, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_least, at_most
from replay.reproduce.service import Sample

FORMS: Final[tuple[Form, ...]] = (CASTERS, BALANCING)
_SPEED: Final = 0.4  # m/s
_TURN: Final = 0.8  # rad/s
_LOOPS: Final = 3
_EXACT: Final = 1e-6  # m, by which a path of ideal wheels closes
_STRAIGHT: Final = 1e-9  # m, by which the width may move it
_EVERY: Final = 5  # cycles between points that are drawn


class _Path(NamedTuple):
    """One of the four. `paper`: cm from start to end and over one loop, None where it prints none."""

    words: str
    course: Course
    loop: float | None = None  # s
    paper: tuple[float, float] | None = None


def _paths() -> tuple[_Path, ...]:
    side, turns, slow = 1.0 / _SPEED, _LOOPS * 2.0 * pi / _TURN, _SPEED / sqrt(2.0)
    square = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
    rhombus = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
    return (
        _Path("square", one_by_one([(side, Rates(_SPEED * x, _SPEED * y)) for x, y in square])),
        _Path("rhombus", one_by_one([(side, Rates(slow * x, slow * y)) for x, y in rhombus])),
        _Path("circle, x and yaw", one_by_one([(turns, Rates(_SPEED, 0.0, _TURN))]), 2.0 * pi / _TURN, (2.42, 0.99)),
        _Path("circle, y and yaw", one_by_one([(turns, Rates(0.0, _SPEED, _TURN))]), 2.0 * pi / _TURN, (2.67, 0.74)),
    )


def figure_8(stage: Stage) -> Found:
    """The four paths: ideal wheels, and every form of the robot on a level floor."""
    rows, panels, sessions = list[Row](), list[Panel](), {}
    for path in _paths():
        stage.tell(path.words)
        poses = ideal(robot_of(CASTERS), path.course)
        rows.append(Row(f"end, {path.words}, ideal wheels", "m", apart(poses[0], poses[-1]), None, "", at_most(_EXACT)))
        lines = [_ideal_line(poses)]
        for colour, form in enumerate(FORMS):
            seen = drive_odd(stage, form, LEVEL, path.course, hold=True)
            sessions[f"{path.words}, {form.words}"] = seen.drive.session
            rows += _closing(path, seen, form.words, bound=form is CASTERS)
            lines.append(_way(seen, form.words, colour))
        panels.append(_above(path.words, lines))
    notes = (
        PAPER_NOTE,
        "The paper drives these balancing, and prints no deviation of them; here the robot goes "
        f"{' and '.join(form.words for form in FORMS)}, on a level floor, with nothing that corrects its place but, "
        "balancing, what leads it back along x.",
        _PATHS_NOTE,
    )
    return Found(tuple(rows), Picture("Figure 8: four paths", (panels[:2], panels[2:])), notes, sessions)


def figure_9(stage: Stage) -> Found:
    """The four paths on ball casters, on a floor and with halves that disturb."""
    rows, panels, sessions = list[Row](), list[Panel](), {}
    for path in _paths():
        stage.tell(path.words)
        seen = drive_odd(stage, CASTERS, TILTED, path.course, hold=True)
        sessions[path.words] = seen.drive.session
        rows += _closing(path, seen, "", bound=True)
        panels.append(
            _above(path.words, [_ideal_line(ideal(robot_of(CASTERS), path.course)), _way(seen, "service", 0)])
        )
    path = _paths()[2]
    stage.tell("nothing holds the width")
    free = drive_odd(stage, CASTERS, TILTED, path.course)
    sessions["nothing holds the width"] = free.drive.session
    drift = 100.0 * (free.widths[-1] - free.widths[0])
    rows.append(Row(f"width gained where nothing holds it, {path.words}, service", "cm", drift, None, "not printed"))
    stage.tell("wheels that do not creep")
    rigid = drive_odd(stage, CASTERS, TILTED._replace(creep=0.0), path.course, hold=True)
    sessions["wheels that do not creep"] = rigid.drive.session
    end = 100.0 * apart(rigid.samples[0], rigid.samples[-1])
    rows.append(Row(f"end, {path.words}, wheels do not creep, service", "cm", end, None, "not printed"))
    notes = (
        PAPER_NOTE,
        _PATHS_NOTE,
        "Floor and disturbances, all ours and none fitted: 0.5 degrees of slope, friction 0.6, left half 53 % of the "
        "mass, rollers that resist 2 % of their load sideways, slides of 2 N and 5 N s/m, casters 0.15 m before and "
        "behind the axle.",
        "Wheels creep: they slip by 5 % of their speed under a push as large as their load, ours too. Then the slope "
        "drifts the circles, as the paper supposes; wheels that do not creep hold against it.",
        "In a turn creeping halves go apart, which the wheels do not tell: the width is measured, and told to stay.",
        "Balls are taken to roll without resistance.",
    )
    return Found(
        tuple(rows), Picture("Figure 9: four paths on ball casters", (panels[:2], panels[2:])), notes, sessions
    )


_PATHS_NOTE: Final = (
    f"Ours: 1 m sides, {_SPEED:g} m/s, circles of {_SPEED / _TURN:g} m radius at {_TURN:g} rad/s and {_LOOPS} loops of "
    "them, all rates of a leg rising and falling together. One loop: the most that its end is off its beginning."
)


def _closing(path: _Path, seen: Seen, form: str, *, bound: bool) -> list[Row]:
    """How far the end is from the start, and a loop's from its own."""
    words = f"{path.words}, {form}".removesuffix(", ")
    samples, paper = seen.samples, path.paper
    end = 100.0 * apart(samples[0], samples[-1])
    told = None if paper is None or form else paper[0]
    allowed = at_most(paper[0]) if paper is not None and bound else None
    note = "" if told is not None else "not printed"
    rows = [Row(f"end, {words}, service", "cm", end, told, note, allowed)]
    if paper is not None and path.loop is not None:
        once = 100.0 * _one_loop(samples, path.loop, path.course)
        told = None if form else paper[1]
        rows.append(Row(f"one loop, {words}, service", "cm", once, told, note, at_most(paper[1]) if bound else None))
    else:
        turned = max(abs(degrees(sample.heading)) for sample in samples)
        rows.append(Row(f"largest turn, {words}, service", "deg", turned, None, "not printed"))
    return rows


def _one_loop(samples: Sequence[Sample], loop: float, course: Course) -> float:
    """m, the most that a place after one turn is off that before it, between the ramps."""
    after = round(loop / samples[1].t)
    first, last = round(course.ramp / samples[1].t), round((course.driven - course.ramp) / samples[1].t) - after
    return max(apart(samples[place], samples[place + after]) for place in range(first, last))


# -- the width in motion ----------------------------------------------------------------------------------------------

_WIDENING: Final = ((1.0, 1.2, 0.12), (3.4, 2.0, -0.12), (6.6, 0.8, 0.12))  # s, s, m/s: 0.4, 0.544, 0.304 and back


class _Change(NamedTuple):
    """A drive while the width goes to and fro. `steady`: the axis whose speed is looked at, of vx, vy and wz."""

    words: str
    base: tuple[Leg, ...]
    steady: int
    preset: float
    unit: str
    start: float = 1.0  # s, from when the speed is steady
    end: float = 8.4


def _changes() -> tuple[_Change, ...]:
    return (
        _Change("along x", (Leg(0.0, 9.0, Rates(0.3)),), 0, 0.3, "m/s"),
        _Change("along y", (Leg(0.0, 9.0, Rates(0.0, 0.05)),), 1, 0.05, "m/s"),
        _Change(
            "x and yaw", (Leg(0.0, 9.0, Rates(0.3)), Leg(2.0, 5.0, Rates(0.0, 0.0, 0.6))), 2, 0.6, "rad/s", 2.8, 6.8
        ),
    )


def figure_10(stage: Stage) -> Found:
    """The width changed along x, along y, and while turning: what becomes of the path and of the speed."""
    rows, panels, sessions = list[Row](), list[tuple[Panel, ...]](), {}
    for change in _changes():
        course = Course([*change.base, *(Leg(start, length, Rates(width=rate)) for start, length, rate in _WIDENING)])
        plain = Course(change.base)
        poses, alone = ideal(robot_of(CASTERS), course), ideal(robot_of(CASTERS), plain)
        moved = max(apart(one, other) for one, other in zip(poses, alone, strict=False))
        rows.append(Row(f"path moved, {change.words}, ideal wheels", "m", moved, None, "", at_most(_STRAIGHT)))
        for form in FORMS:
            stage.tell(f"{change.words}, {form.words}")
            seen = drive_odd(stage, form, TILTED, course)
            words = f"{change.words}, {form.words}"
            sessions[words] = seen.drive.session
            rows += _changed(change, seen, poses, words)
            panels.append(_change_panels(change, seen, words))
    notes = (
        PAPER_NOTE,
        "Speeds, widths (0.4 to 0.54, 0.3 and back) and floor (that of figure 9) are ours; as in the paper half of the "
        "width's rate, 0.06 m/s, is more than the speed along y, 0.05 m/s, so that one pair turns back.",
        "Along y the paper's robot takes the speed of half of the width's rate, as a pair that would turn back sticks. "
        "Here its wheels' loops turn it back; dry friction in this plant is the same at rest and in motion.",
    )
    return Found(tuple(rows), Picture("Figure 10: the width changed in motion", panels), notes, sessions)


def _changed(change: _Change, seen: Seen, poses: Sequence[Pose], words: str) -> list[Row]:
    samples = seen.samples
    beside = 100.0 * max(_beside(samples[place], poses, place) for place in range(0, len(samples), _EVERY))
    steady = [_body(sample)[change.steady] for sample in samples if change.start <= sample.t <= change.end]
    off = max(abs(one - change.preset) for one in steady)
    spread = max(seen.widths) - min(seen.widths)
    return [
        Row(f"beside the path of ideal wheels, {words}, service", "cm", beside, None, "not printed"),
        Row(f"speed off its preset, {words}, service", change.unit, off, None, "not printed"),
        Row(f"width changed, {words}, service", "m", spread, None, "not printed", at_least(0.2)),
    ]


def _beside(sample: Sample, poses: Sequence[Pose], place: int) -> float:
    """m from the nearest place of ideal wheels within half a second: it comes later, as every robot."""
    return min(apart(sample, pose) for pose in poses[max(0, place - 125) : place + 125])


def _body(sample: Sample) -> tuple[float, float, float]:
    c, s = cos(sample.heading), sin(sample.heading)
    return c * sample.vx + s * sample.vy, c * sample.vy - s * sample.vx, sample.wz


def _change_panels(change: _Change, seen: Seen, words: str) -> tuple[Panel, ...]:
    left, right = seen.pairs()
    samples = seen.samples[::_EVERY]
    times = [sample.t for sample in samples]
    above = _above(words, _three(seen))
    if change.steady == 1:  # all three along one line: over time instead
        pairs = (("left pair", left, 1), ("right pair", right, 2))
        lines = [Line(label, times, [y for _, y in pair[::_EVERY]], colour) for label, pair, colour in pairs]
        lines.append(Line("middle", times, [sample.y for sample in samples], 0))
        above = Panel(f"Sideways, {words}", "t [s]", "y [m]", lines=lines)
    speed = Panel(
        f"Width and speed, {words}",
        "t [s]",
        f"[m], [{change.unit}]",
        lines=(
            Line("width", times, seen.widths[::_EVERY], 3),
            Line("speed", times, [_body(sample)[change.steady] for sample in samples], 0),
        ),
        marks=tuple(Mark("", start, start + length + 0.4) for start, length, _ in _WIDENING),
    )
    return above, speed


# -- passages ---------------------------------------------------------------------------------------------------------

Box = tuple[float, float, float, float]  # m: from x, to x, from y, to y
_WHEEL: Final = 0.02  # m, half of a wheel's width
_CHANNEL: Final = ((0.9, 1.5, 0.23, 0.9), (0.9, 1.5, -0.9, -0.23))
_GAP: Final = ((1.6, 2.28, 0.9, 1.4), (2.72, 3.4, 0.9, 1.4))


def _passing() -> Course:
    """Narrow into the channel, wide behind it, then sideways through the gap and on, never turning."""
    return Course(
        [
            Leg(0.0, 1.0, Rates(width=-0.12)),  # 0.4 to 0.28
            Leg(0.6, 6.25, Rates(0.4)),  # 2.5 m
            Leg(5.2, 1.5, Rates(width=0.16)),  # to 0.52
            Leg(7.4, 6.0, Rates(0.0, 0.3)),  # 1.8 m
            Leg(12.0, 1.0, Rates(width=-0.12)),  # to 0.4
        ]
    )


def figure_11(stage: Stage) -> Found:
    """A channel that only the narrow robot fits through, and a gap that it goes through sideways."""
    rows, panels, sessions = list[Row](), list[Panel](), {}
    course = _passing()
    spacing = robot_of(CASTERS).spacing
    for form in FORMS:
        stage.tell(form.words)
        seen = drive_odd(stage, form, TILTED, course)
        sessions[form.words] = seen.drive.session
        start = 0.5 * seen.widths[0] + 0.5 * spacing + _WHEEL
        fits = 100.0 * (_CHANNEL[0][2] - start)
        for words, walls in (("channel", _CHANNEL), ("gap, sideways", _GAP)):
            room = 100.0 * _room(seen, walls, form.reach, spacing)
            rows.append(Row(f"room in the {words}, {form.words}, service", "cm", room, None, "", at_least(0.5)))
        rows.append(Row(f"room it would have in the channel as it starts, {form.words}, service", "cm", fits))
        end = 100.0 * hypot(seen.samples[-1].x - 2.5, seen.samples[-1].y - 1.8)
        rows.append(Row(f"end off its place, {form.words}, service", "cm", end))
        lines = _three(seen)
        lines += [_outline(box, "walls" if place == 0 else "") for place, box in enumerate((*_CHANNEL, *_GAP))]
        panels.append(_above(form.words, lines))
    notes = (
        PAPER_NOTE,
        "Walls and course are ours: a channel 0.46 m wide, where the robot is 0.54 m at the start and 0.42 m in it, "
        "and a gap of 0.44 m that it goes through sideways, 0.34 m long with its casters. It is led by speeds and "
        "times alone, nothing corrects its place. The floor is that of figure 9.",
        "Most of how far the end is off comes where the width meets its limit of acceleration while x brakes: the "
        "setpoint keeps its direction in all four axes, and x brakes later. With the width still it is 1 mm along x.",
        "The paper shows pictures of a video and prints no size.",
    )
    return Found(tuple(rows), Picture("Figure 11: passages", (panels,)), notes, sessions)


def _room(seen: Seen, walls: Sequence[Box], reach: float, spacing: float) -> float:
    """m between the outline of the robot and the nearest wall; below zero inside of one."""
    least = inf
    for sample, width in zip(seen.samples[::_EVERY], seen.widths[::_EVERY], strict=True):
        corners = _corners(sample, reach, 0.5 * (width + spacing) + _WHEEL)
        least = min([least, *(_outside(x, y, wall) for x, y in corners for wall in walls)])
    return least


def _corners(sample: Sample, length: float, width: float) -> list[tuple[float, float]]:
    c, s = cos(sample.heading), sin(sample.heading)
    ends = [(a * length, b * width) for a in (1.0, -1.0) for b in (1.0, 0.5, 0.0, -0.5, -1.0)]
    return [(sample.x + c * x - s * y, sample.y + s * x + c * y) for x, y in ends]


def _outside(x: float, y: float, box: Box) -> float:
    """m from a point to a box, below zero within."""
    dx, dy = max(box[0] - x, x - box[1]), max(box[2] - y, y - box[3])
    return hypot(max(dx, 0.0), max(dy, 0.0)) if max(dx, dy) > 0.0 else max(dx, dy)


def _outline(box: Box, label: str) -> Line:
    x0, x1, y0, y1 = box
    return Line(label, [x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], 7)


# -- drawing ----------------------------------------------------------------------------------------------------------


def _way(seen: Seen, label: str, colour: int) -> Line:
    samples = seen.samples[::_EVERY]
    return Line(label, [sample.x for sample in samples], [sample.y for sample in samples], colour)


def _three(seen: Seen) -> list[Line]:
    """Both pairs and the middle between them."""
    left, right = seen.pairs()
    return [
        Line("left pair", [x for x, _ in left[::_EVERY]], [y for _, y in left[::_EVERY]], 1),
        Line("right pair", [x for x, _ in right[::_EVERY]], [y for _, y in right[::_EVERY]], 2),
        _way(seen, "middle", 0),
    ]


def _ideal_line(poses: Sequence[Pose]) -> Line:
    return Line("ideal wheels", [p.x for p in poses[::_EVERY]], [p.y for p in poses[::_EVERY]], 7, dashed=True)


def _above(words: str, lines: Sequence[Line]) -> Panel:
    return Panel(f"From above: {words}", "x [m]", "y [m]", lines=tuple(lines), to_scale=True)
