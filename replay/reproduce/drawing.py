"""Draws a picture into a PNG file, without a display. The only module that knows Matplotlib."""

from collections.abc import Sequence
from math import cos, hypot, sin
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from replay.reproduce.picture import DrawnRobot, Panel, Picture, Shape

_DPI = 110
_WIDTH = 11.0  # inches
_ROW = 3.6
_MAP_ROW = (2.2, 7.5)  # a map is as high as its place is, within these
_BODY = "#44546a"
_WHEEL = "#1b1b1b"
_CASTER = "#c55a11"
_PAPER = "#b00020"


def draw(picture: Picture, path: Path) -> None:
    """Into this file. Raises OSError."""
    heights = [_height(row) for row in picture.rows]
    figure = Figure(figsize=(_WIDTH, sum(heights) + 0.5), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(picture.title, fontsize=14, fontweight="bold")
    grids = figure.subfigures(len(picture.rows), 1, height_ratios=heights, squeeze=False)
    for grid, row in zip(grids[:, 0], picture.rows, strict=True):
        for axes, panel in zip(grid.subplots(1, len(row), squeeze=False)[0], row, strict=True):
            _panel(axes, panel)
    figure.savefig(path, format="png")


def _height(row: Sequence[Panel]) -> float:
    """Inches."""
    return max(_map_height(panel, len(row)) if panel.is_map else _ROW for panel in row)


def _map_height(panel: Panel, beside: int) -> float:
    (left, right), (low, high) = _extent(panel)
    room = (high - low) / (right - left) * (_WIDTH / beside - 1.0) + 1.1
    return min(max(room, _MAP_ROW[0]), _MAP_ROW[1])


def _extent(panel: Panel) -> tuple[tuple[float, float], tuple[float, float]]:
    """Of a map, with room for the robots on it, m."""
    shape = panel.shape
    margin = 0.0 if shape is None or not panel.robots else _reach(shape)
    xs = [x for line in panel.lines for x in line.x] + [a.x + s * a.dx for a in panel.arrows for s in (0.0, 1.0)]
    ys = [y for line in panel.lines for y in line.y] + [a.y + s * a.dy for a in panel.arrows for s in (0.0, 1.0)]
    width = max(max(xs) - min(xs), 1e-6)
    extra = margin + 0.02 * width
    return (min(xs) - extra, max(xs) + extra), (min(ys) - extra, max(ys) + extra)


def _reach(shape: Shape) -> float:
    back = hypot(shape.axle_offset + shape.wheel_radius, 0.5 * shape.track)
    return max(back, shape.caster_position + shape.trail + shape.caster_radius)


def _panel(axes: Axes, panel: Panel) -> None:
    axes.set_title(panel.title, fontsize=10)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for mark in panel.marks:
        if mark.start == mark.end:
            axes.axvline(mark.start, color="#7f6000", linewidth=1.0, linestyle=":", label=mark.label or None)
        else:
            axes.axvspan(mark.start, mark.end, color="#fff2cc", label=mark.label or None)
    if panel.shape is not None:
        for robot in panel.robots:
            _robot(axes, robot, panel.shape)
    for line in panel.lines:
        style = "--" if line.dashed else "-"
        axes.plot(line.x, line.y, style, color=f"C{line.colour}", linewidth=1.4, label=line.label)
    for level in panel.levels:
        axes.axhline(level.value, color=_PAPER, linewidth=1.1, linestyle="--", label=level.label or None)
    for arrow in panel.arrows:
        axes.annotate(
            arrow.label,
            xy=(arrow.x + arrow.dx, arrow.y + arrow.dy),
            xytext=(arrow.x, arrow.y),
            color=_PAPER,
            fontsize=8,
            ha="center",
            va="center",
            arrowprops={"arrowstyle": "-|>", "color": _PAPER, "linewidth": 1.6},
            zorder=5,
        )
    if panel.y_range is not None:
        axes.set_ylim(*panel.y_range)
    if panel.is_map:
        (left, right), (low, high) = _extent(panel)
        axes.set_xlim(left, right)
        axes.set_ylim(low, high)
        axes.set_aspect("equal", adjustable="box")
    if any(line.label for line in panel.lines) or panel.levels:
        axes.legend(fontsize=7.5, loc="best", framealpha=0.85)


def _robot(axes: Axes, robot: DrawnRobot, shape: Shape) -> None:
    """Frame, wheels, joint and, where it is known, the caster."""
    half, back, front = 0.5 * shape.track, -shape.axle_offset, shape.caster_position
    frame = ((back, half), (front, 0.25 * half), (front, -0.25 * half), (back, -half), (back, half))
    _stroke(axes, robot, frame, _BODY, 0.9)
    for side in (half, -half):
        _stroke(axes, robot, ((back - shape.wheel_radius, side), (back + shape.wheel_radius, side)), _WHEEL, 3.0)
    if robot.swivel is not None:
        s, c = sin(robot.swivel), cos(robot.swivel)
        wheel = (front + shape.trail * s, -shape.trail * c)
        r = shape.caster_radius
        _stroke(axes, robot, ((front, 0.0), wheel), _CASTER, 0.9)
        ends = ((wheel[0] - r * s, wheel[1] + r * c), (wheel[0] + r * s, wheel[1] - r * c))
        _stroke(axes, robot, ends, _CASTER, 2.2)
    axes.add_patch(Circle((robot.x, robot.y), 0.03, color=_BODY, zorder=3))


def _stroke(axes: Axes, robot: DrawnRobot, points: Sequence[tuple[float, float]], colour: str, width: float) -> None:
    """A line in the frame of the chassis."""
    c, s = cos(robot.heading), sin(robot.heading)
    xs = [robot.x + c * x - s * y for x, y in points]
    ys = [robot.y + s * x + c * y for x, y in points]
    axes.plot(xs, ys, color=colour, linewidth=width, solid_capstyle="butt", alpha=0.8)
