"""Pictures of a report as SVG inside the page: its colours are those of the page's theme, and nothing is fetched."""

from collections.abc import Iterable, Sequence
from html import escape
from math import ceil, floor, inf, isfinite, log10
from typing import NamedTuple

import numpy as np

from replay.report.binned import Numbers
from replay.report.gather import Happened, Plot, Series, Timing, Way
from replay.sessions.summary import Stay

WIDTH, LEFT, RIGHT, BOTTOM = 1000.0, 64.0, 12.0, 24.0
PLOT_HEIGHT, TOP = 200.0, 8.0
ROW = 22.0
MAP_HEIGHT = (160.0, 560.0)
TICKS = 6
COLOURS = 8  # .c0 to .c7 of the page
MODES = ("idle", "starting", "drive", "degraded", "stopping", "estop", "fault")  # .m-… of the page
LABELLED = 60.0  # a mode that is shorter has its name only in the tooltip
LATENCIES_US = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000)


class _Scale(NamedTuple):
    """From a value to a place in the picture."""

    low: float
    high: float
    start: float
    end: float

    def at(self, value: float) -> float:
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)


def plot(told: Plot, times: Numbers, seconds: float, gaps: Sequence[tuple[float, float]]) -> str:
    """Channels over time, with their legend."""
    x = _time_scale(seconds)
    low, high = _range(told.series)
    y = _Scale(low, high, TOP + PLOT_HEIGHT, TOP)
    parts = [_gaps(gaps, x, TOP, PLOT_HEIGHT), _grid(x, y)]
    asked = {one.label: place for place, one in enumerate(told.series)}
    colours = _colours(told.series)
    for one in sorted(told.series, key=lambda one: not one.asked):
        parts.append(_curve(one, times, x, y, colours[asked[one.label]]))
    keys = "".join(_key(one, colour) for one, colour in zip(told.series, colours, strict=True))
    return _svg(told.title, TOP + PLOT_HEIGHT + BOTTOM, parts) + f'<p class="keys">{keys}</p>'


def timeline(
    modes: Sequence[Stay], events: Sequence[Happened], seconds: float, gaps: Sequence[tuple[float, float]]
) -> str:
    """A row for the modes, and one for each kind of event."""
    x = _time_scale(seconds, left=LEFT + 116.0)
    height = ROW * (1 + len(events))
    parts = [_gaps(gaps, x, TOP, height), _time_axis(x, TOP, TOP + height)]
    parts += [_stay(one, x) for one in modes]
    parts.append(_text(x.start - 8.0, TOP + 0.68 * ROW, "mode", "end"))
    for number, one in enumerate(events, start=1):
        top = TOP + number * ROW
        parts.append(_text(x.start - 8.0, top + 0.68 * ROW, one.code, "end"))
        places = sorted({round(x.at(t)) for t in one.times})
        marks = "".join(f"M{place} {top + 3:g}v{ROW - 6:g}" for place in places)
        parts.append(f'<path class="event {escape(one.level)}" d="{marks}"/>')
    return _svg("Modes and faults", TOP + height + BOTTOM, parts)


def way(told: Way) -> str:
    """From above, x to the right and y up, to scale."""
    left, right = _padded(float(np.nanmin(told.x)), float(np.nanmax(told.x)))
    low, high = _padded(float(np.nanmin(told.y)), float(np.nanmax(told.y)))
    room = WIDTH - LEFT - RIGHT
    height = min(max((high - low) / (right - left) * room, MAP_HEIGHT[0]), MAP_HEIGHT[1])
    metres = max((right - left) / room, (high - low) / height)  # per unit of the picture
    x = _Scale(*_around(left, right, metres * room), LEFT, WIDTH - RIGHT)
    y = _Scale(*_around(low, high, metres * height), TOP + height, TOP)
    line = _path(((x.at(a), y.at(b)) for a, b in zip(told.x.tolist(), told.y.tolist(), strict=True)))
    known = np.flatnonzero(np.isfinite(told.x))
    ends = [(x.at(float(told.x[n])), y.at(float(told.y[n]))) for n in (known[0], known[-1])]
    parts = [_grid(x, y), f'<path class="line c0" d="{line}"/>']
    parts.append(f'<circle class="begin" cx="{ends[0][0]:.1f}" cy="{ends[0][1]:.1f}" r="6"/>')
    parts.append(f'<circle class="end" cx="{ends[1][0]:.1f}" cy="{ends[1][1]:.1f}" r="4"/>')
    return _svg("Path from above [m]", TOP + height + BOTTOM, parts)


def histogram(told: Timing) -> str:
    """In how many cycles the loop was so late and took so long: both axes logarithmic."""
    edges = (-inf, *LATENCIES_US, inf)
    counts = [np.histogram(values, edges)[0].tolist() for values in (told.late, told.work)]
    top = ceil(log10(max(10, *counts[0], *counts[1])))
    y = _Scale(-0.3, float(top), TOP + PLOT_HEIGHT, TOP)  # a single cycle is still seen
    step = (WIDTH - LEFT - RIGHT) / len(counts[0])
    parts = [_level(y.at(power), f"{10**power:,}") for power in range(top + 1)]
    for colour, values in enumerate(counts):
        for place, count in enumerate(values):
            if count:
                x = LEFT + (place + 0.1 + 0.4 * colour) * step
                at = y.at(log10(count))
                box = f'x="{x:.1f}" y="{at:.1f}" width="{0.4 * step:.1f}" height="{y.start - at:.1f}"'
                parts.append(f'<rect class="bar c{colour}" {box}><title>{count:,} cycles</title></rect>')
    for place, edge in enumerate(LATENCIES_US, start=1):
        parts.append(_text(LEFT + place * step, y.start + 16.0, _latency(edge), "middle"))
    keys = "".join(f'<span><i class="c{n}"></i>{words}</span>' for n, words in enumerate(("late", "work")))
    return _svg("Latency", TOP + PLOT_HEIGHT + BOTTOM, parts) + f'<p class="keys">{keys}</p>'


def _latency(us: int) -> str:
    return f"{us} us" if us < 1000 else f"{us // 1000} ms"


def _svg(title: str, height: float, parts: Iterable[str]) -> str:
    box = f'viewBox="0 0 {WIDTH:g} {height:g}"'
    return f'<svg {box} role="img" aria-label="{escape(title)}">{"".join(parts)}</svg>'


def _text(x: float, y: float, words: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def _time_scale(seconds: float, left: float = LEFT) -> _Scale:
    return _Scale(0.0, max(seconds, 1e-3), left, WIDTH - RIGHT)


def _grid(x: _Scale, y: _Scale) -> str:
    return "".join(_level(y.at(value), _figure(value)) for value in _ticks(y)) + _time_axis(x, y.end, y.start)


def _level(y: float, words: str) -> str:
    line = f'<path class="grid" d="M{LEFT:g} {y:.1f}H{WIDTH - RIGHT:g}"/>'
    return line + _text(LEFT - 6.0, y + 4.0, words, "end")


def _time_axis(x: _Scale, top: float, bottom: float) -> str:
    lines = "".join(f"M{x.at(value):.1f} {top:g}V{bottom:g}" for value in _ticks(x))
    words = "".join(_text(x.at(value), bottom + 16.0, _figure(value), "middle") for value in _ticks(x))
    return f'<path class="grid" d="{lines}"/>{words}'


def _ticks(scale: _Scale) -> list[float]:
    """Round values: 1, 2 or 5 times a power of ten apart."""
    rough = (scale.high - scale.low) / TICKS
    power = 10.0 ** floor(log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    return [number * step for number in range(ceil(scale.low / step), floor(scale.high / step) + 1)]


def _figure(value: float) -> str:
    return f"{value:.6g}"


def _range(series: Sequence[Series]) -> tuple[float, float]:
    low = min(float(np.nanmin(one.low)) for one in series)
    high = max(float(np.nanmax(one.high)) for one in series)
    return _padded(low, high)


def _padded(low: float, high: float) -> tuple[float, float]:
    """With some room, also where nothing changes."""
    room = 0.05 * (high - low) if high - low > 1e-9 else max(0.05, 0.05 * abs(low))
    return low - room, high + room


def _around(low: float, high: float, size: float) -> tuple[float, float]:
    middle = 0.5 * (low + high)
    return middle - 0.5 * size, middle + 0.5 * size


def _colours(series: Sequence[Series]) -> list[int]:
    """What was asked for has the colour of what was measured: both are numbered from 0."""
    counts = {True: 0, False: 0}
    found = []
    for one in series:
        found.append(counts[one.asked] % COLOURS)
        counts[one.asked] += 1
    return found


def _curve(one: Series, times: Numbers, x: _Scale, y: _Scale, colour: int) -> str:
    """From the least to the greatest of each stretch and on to the next."""
    points = []
    for t, low, high in zip(times.tolist(), one.low.tolist(), one.high.tolist(), strict=True):
        points.append((x.at(t), y.at(low)))
        if high > low:
            points.append((x.at(t), y.at(high)))
    asked = " asked" if one.asked else ""
    return f'<path class="line c{colour}{asked}" d="{_path(points)}"/>'


def _path(points: Iterable[tuple[float, float]]) -> str:
    """NaN parts its pieces."""
    found, pen = [], "M"
    for a, b in points:
        if isfinite(a) and isfinite(b):
            found.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(found)


def _gaps(gaps: Sequence[tuple[float, float]], x: _Scale, top: float, height: float) -> str:
    found = []
    for begin, end in gaps:
        box = f'x="{x.at(begin):.1f}" y="{top:g}" width="{max(x.at(end) - x.at(begin), 1.0):.1f}" height="{height:g}"'
        found.append(f'<rect class="gap" {box}><title>not recorded: {begin:.3f} to {end:.3f} s</title></rect>')
    return "".join(found)


def _stay(one: Stay, x: _Scale) -> str:
    begin, width = x.at(one.t), max(x.at(one.t + one.seconds) - x.at(one.t), 1.0)
    kind = one.mode if one.mode in MODES else "other"
    box = f'x="{begin:.1f}" y="{TOP + 2:g}" width="{width:.1f}" height="{ROW - 4:g}"'
    told = f"<title>{escape(one.mode)}: {one.t:.3f} s, for {one.seconds:.3f} s</title>"
    words = _text(begin + 0.5 * width, TOP + 0.68 * ROW, one.mode, "middle") if width >= LABELLED else ""
    return f'<rect class="m-{kind}" {box}>{told}</rect><g class="on">{words}</g>'


def _key(one: Series, colour: int) -> str:
    asked = " asked" if one.asked else ""
    return f'<span><i class="c{colour}{asked}"></i>{escape(one.label)}</span>'
