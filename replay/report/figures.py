"""The figures of a report as the template draws them: places, paths and words, no markup."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from math import ceil, degrees, log10
from typing import NamedTuple

import numpy as np

from gateway.chassis.contract import Drawing
from replay.report.binned import Counts, Stretches
from replay.report.plots import Panel, Series
from replay.report.said import MOVING, RESTING, Happened, Said
from replay.report.scales import HIGH, WIDE, Scale, Tick, across, padded, path, ticks, upwards
from replay.report.timing import Latency, Timing
from replay.report.track import Station, Track, apart
from replay.sessions.summary import Stay

TIMES, VALUES = 6, 4  # ticks at most
COLOURS = 8  # .c0 to .c7 of the page
MODES = ("idle", "starting", "drive", "degraded", "stopping", "estop", "fault")  # .m-… of the page
SHOWN = {("info", f"mode_{mode}") for mode in MODES}  # by the row of the modes
LEVELS = ("error", "warning", "request", "info")  # in the order of their rows
NAMED = 0.02  # of the width: a mode that is shorter has its name in the legend alone
MOST_ROWS = 24
ROBOTS = 10  # drawn along a path, besides those at its ends
LEAST = 8.0  # of the width of a figure: two pixels of a screen
MAP_WIDE = 1000.0
MAP_SHAPES = (0.3, 0.5)  # height by width
LATENCIES_US = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000)


class Curve(NamedTuple):
    """A line, and how the page draws it."""

    kind: str
    label: str
    line: str


class Box(NamedTuple):
    """From left on so wide, in units of the picture; `words` of it, `kind` how the page draws it."""

    left: float
    width: float
    kind: str
    words: str


class Chart(NamedTuple):
    """Curves over time."""

    name: str
    unit: str
    x: Sequence[Tick]
    y: Sequence[Tick]
    curves: Sequence[Curve]
    gaps: Sequence[Box]


class Row(NamedTuple):
    """Of the timeline: what was when. `marks`: a line of strokes; `named`: boxes wide enough for their words."""

    name: str
    kind: str
    boxes: Sequence[Box] = ()
    marks: str = ""
    words: str = ""

    @property
    def named(self) -> list[Box]:
        return [box for box in self.boxes if box.width >= NAMED * WIDE and box.words]


class Timeline(NamedTuple):
    """`modes`: each with the seconds spent in it; `left_out`: rows that have no place."""

    rows: Sequence[Row]
    x: Sequence[Tick]
    gaps: Sequence[Box]
    modes: Sequence[tuple[str, str, float]]
    left_out: int


class Placed(NamedTuple):
    """A robot on the map: where, turned by so many degrees, its chassis beneath by so many more."""

    x: float
    y: float
    turned: float
    beneath: float
    kind: str


class Map(NamedTuple):
    """A path from above, of `high` units for every thousand across, `unit` of them a metre."""

    high: float
    unit: float
    x: Sequence[Tick]
    y: Sequence[Tick]
    curves: Sequence[Curve]
    robots: Sequence[Placed]
    drawing: Drawing


class Histogram(NamedTuple):
    """Cycles by latency, both axes logarithmic. `boxes`: their words are numbers of cycles; `tops` where they end."""

    x: Sequence[Tick]
    y: Sequence[Tick]
    bars: Sequence[tuple[Box, float]]


def chart(panel: Panel, stretches: Stretches, seconds: float, gaps: Sequence[tuple[float, float]]) -> Chart:
    """What shares an axis, zero with it where something is asked for."""
    x, compared = across(seconds), any(one.asked for one in panel.series)
    ends = [0.0] * compared + [float(end) for one in panel.series for end in (np.nanmin(one.low), np.nanmax(one.high))]
    y = upwards(min(ends), max(ends))
    kinds = _kinds(panel.series)
    curves = [
        Curve(kind, one.label, path(_points(one, stretches, x, y)))
        for one, kind in zip(panel.series, kinds, strict=True)
    ]
    return Chart(panel.owner, panel.unit, ticks(x, TIMES, " s"), ticks(y, VALUES), curves, missing(gaps, seconds))


def missing(gaps: Sequence[tuple[float, float]], seconds: float) -> list[Box]:
    """Where cycles are; gaps with hardly anything between them as one."""
    x, near = across(seconds), seconds * LEAST / WIDE
    joined: list[tuple[float, float]] = []
    for begin, end in gaps:
        if joined and begin - joined[-1][1] < near:
            joined[-1] = joined[-1][0], end
        else:
            joined.append((begin, end))
    return [
        Box(x.at(begin), max(x.at(end) - x.at(begin), LEAST), "gap", f"not recorded: {begin:.3f} s to {end:.3f} s")
        for begin, end in joined
    ]


def _widest(boxes: Iterable[Box], apart: float) -> list[Box]:
    """Of boxes that begin at the same place the widest, so that there are only so many."""
    found: dict[int, Box] = {}
    for box in boxes:
        place = int(box.left / apart)
        if place not in found or found[place].width < box.width:
            found[place] = box
    return list(found.values())


def _kinds(series: Sequence[Series]) -> list[str]:
    """What was measured in colours by its place, what was asked for dashed and in the colour of that."""
    measured = iter(range(len(series)))
    return ["asked" if one.asked else f"c{next(measured) % COLOURS}" for one in series]


def _points(one: Series, stretches: Stretches, x: Scale, y: Scale) -> Iterator[tuple[float, float]]:
    """Through the least and the greatest of each stretch, the nearer one first."""
    last = 0.0
    for t, low, high in zip(stretches.times.tolist(), one.low.tolist(), one.high.tolist(), strict=True):
        ends = (low, high) if abs(low - last) <= abs(high - last) else (high, low)
        for value in ends[: 1 if low == high else 2]:
            yield x.at(t), y.at(value)
        last = ends[1]


def timeline(
    modes: Sequence[Stay], said: Said, stretches: Stretches, seconds: float, gaps: Sequence[tuple[float, float]]
) -> Timeline:
    """Modes, what each source commanded, requests and events."""
    x = across(seconds)
    rows = [Row("mode", "modes", _widest((_stay(one, x) for one in modes), 1.0))]
    rows += [
        Row(one.source, "commands", _widest(_commands(one.stretches, stretches, x), LEAST))
        for one in said.commanders.values()
    ]
    happened = sorted(said.happened, key=lambda one: LEVELS.index(one.level))
    rows += [_marks(one, stretches, x) for one in happened if (one.level, one.code) not in SHOWN]
    spent = {one.mode: 0.0 for one in modes}
    for one in modes:
        spent[one.mode] += one.seconds
    legend = [(mode, _mode(mode), seconds) for mode, seconds in spent.items()]
    return Timeline(
        rows[:MOST_ROWS], ticks(x, TIMES, " s"), missing(gaps, seconds), legend, max(0, len(rows) - MOST_ROWS)
    )


def _mode(mode: str) -> str:
    return f"m-{mode if mode in MODES else 'other'}"


def _stay(one: Stay, x: Scale) -> Box:
    begin = x.at(one.t)
    return Box(begin, max(x.at(one.t + one.seconds) - begin, 4.0), _mode(one.mode), one.mode)


def _commands(found: Counts, stretches: Stretches, x: Scale) -> Iterator[Box]:
    """Where a source commanded rest, and where motion."""
    changes = [0, *(np.flatnonzero(np.diff(found)) + 1).tolist(), len(found)]
    kinds = {RESTING: ("resting", "commands rest"), MOVING: ("moving", "commands motion")}
    for begin, end in pairwise(changes):
        if found[begin]:
            left = x.at(begin * stretches.width)
            yield Box(left, x.at(end * stretches.width) - left, *kinds[int(found[begin])])


def _marks(one: Happened, stretches: Stretches, x: Scale) -> Row:
    places = [round(x.at(t)) for t in stretches.times[one.counts > 0].tolist()]
    total = int(one.counts.sum())
    marks = "".join(f"M{place} 120V880" for place in places)
    return Row(one.code, one.level, marks=marks, words=f"{one.level} {one.code}: {total} times" if total > 1 else "")


def from_above(track: Track, drawing: Drawing) -> Map | None:
    """x to the right and y up, to scale; the path by mode, with the robot along it. None: there is no path."""
    stations = [here for piece in track.pieces for here in piece]
    if not stations:
        return None
    (left, right), (low, high) = (_extent([getattr(here, axis) for here in stations], drawing.reach) for axis in "xy")
    shape = min(max((high - low) / (right - left), MAP_SHAPES[0]), MAP_SHAPES[1])
    metres = max(right - left, (high - low) / shape)  # across
    x = Scale(*_around(left, right, metres), 0.0, MAP_WIDE)
    y = Scale(*_around(low, high, metres * shape), MAP_WIDE * shape, 0.0)
    curves = [
        Curve(_mode(mode), mode, path((4 * x.at(here.x), 4 * y.at(here.y)) for here in some))
        for piece in track.pieces
        for mode, some in _by_mode(piece)
    ]
    robots = [_placed(here, x, y, kind) for here, kind in _robots(stations, drawing.reach)]
    return Map(MAP_WIDE * shape, MAP_WIDE / metres, ticks(x, 8, " m"), ticks(y, 6), curves, robots, drawing)


def _extent(values: Sequence[float], room: float) -> tuple[float, float]:
    low, high = padded(min(values), max(values))
    return low - 1.2 * room, high + 1.2 * room


def _around(low: float, high: float, size: float) -> tuple[float, float]:
    middle = 0.5 * (low + high)
    return middle - 0.5 * size, middle + 0.5 * size


def _by_mode(piece: Sequence[Station]) -> Iterator[tuple[str, list[Station]]]:
    """Stretches of a path, each up to where the next begins."""
    begin = 0
    for place in range(1, len(piece)):
        if piece[place].mode != piece[begin].mode:
            yield piece[begin].mode, list(piece[begin : place + 1])
            begin = place
    yield piece[begin].mode, list(piece[begin:])


def _robots(stations: Sequence[Station], reach: float) -> list[tuple[Station, str]]:
    """At both ends, and along the way as often as they have room."""
    way = sum(apart(one, other) for one, other in pairwise(stations))
    step = max(2.6 * reach, way / (ROBOTS + 1))
    found, since = [], 0.0
    for one, other in pairwise(stations):
        since += apart(one, other)
        if since >= step and apart(other, stations[-1]) > 2.2 * reach and apart(other, stations[0]) > 2.2 * reach:
            found.append((other, "ghost"))
            since = 0.0
    return [*found, (stations[0], "begin"), (stations[-1], "end")]


def _placed(here: Station, x: Scale, y: Scale, kind: str) -> Placed:
    """SVG turns clockwise for who has y up; its y is turned over by the template."""
    return Placed(x.at(here.x), y.at(here.y), -degrees(here.theta), -degrees(here.joint), kind)


def histogram(told: Timing) -> Histogram:
    """In how many cycles the loop was so late and took so long."""
    counts = [_counts(one) for one in (told.late, told.work)]
    top = ceil(log10(max(10, *counts[0], *counts[1])))
    y = Scale(-0.3, float(top), HIGH, 0.0)  # a single cycle is still seen
    step = WIDE / len(counts[0])
    bars = [
        (Box((place + 0.1 + 0.4 * number) * step, 0.4 * step, f"c{number}", f"{count:,} cycles"), y.at(log10(count)))
        for number, values in enumerate(counts)
        for place, count in enumerate(values)
        if count
    ]
    x = [
        Tick(round(100.0 * place / len(counts[0]), 2), _latency(edge))
        for place, edge in enumerate(LATENCIES_US)
        if str(edge).strip("0") == "1"
    ]
    return Histogram(x, [Tick(round(0.1 * y.at(power), 2), f"{10**power:,}") for power in range(top + 1)], bars)


def _counts(one: Latency) -> list[int]:
    bounds = [-1.0, *map(float, LATENCIES_US[1:]), np.inf]
    return [one.between(low, high) for low, high in pairwise(bounds)]


def _latency(us: int) -> str:
    return f"{us} µs" if us < 1000 else f"{us // 1000} ms"
