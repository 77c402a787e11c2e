"""What a picture shows, as plain data; `drawing` is the only module that knows how to draw it."""

from collections.abc import Sequence
from typing import NamedTuple


class Line(NamedTuple):
    """A curve. `dashed`: what was intended, or the paper's; `colour`: its number, 0 to 9, shared by what belongs."""

    label: str
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    dashed: bool = False


class Level(NamedTuple):
    """A value of the paper, dashed across the panel."""

    label: str
    value: float


class Mark(NamedTuple):
    """A moment or a stretch of the x axis: from, to (the same: a moment)."""

    label: str
    start: float
    end: float


class Arrow(NamedTuple):
    """At a place, into a direction: m."""

    label: str
    x: float
    y: float
    dx: float
    dy: float


class DrawnRobot(NamedTuple):
    """Seen from above: joint, heading of the chassis, swivel of its caster (None: none drawn); m and rad."""

    x: float
    y: float
    heading: float
    swivel: float | None = None


class Shape(NamedTuple):
    """Of the robots in a panel, m: d1, d2, R, and of the caster d4, d3, Rc."""

    axle_offset: float
    track: float
    wheel_radius: float
    caster_position: float
    trail: float
    caster_radius: float

    def times(self, factor: float) -> "Shape":
        """Drawn so many times as large."""
        return Shape(*(factor * length for length in self))


class Panel(NamedTuple):
    """One pair of axes. With `shape` it is a map: the same scale both ways, and `robots` are drawn on it."""

    title: str
    x_label: str
    y_label: str
    lines: Sequence[Line] = ()
    levels: Sequence[Level] = ()
    marks: Sequence[Mark] = ()
    arrows: Sequence[Arrow] = ()
    robots: Sequence[DrawnRobot] = ()
    shape: Shape | None = None
    y_range: tuple[float, float] | None = None  # what of the y axis is shown; None: everything
    to_scale: bool = False  # a map without robots

    @property
    def is_map(self) -> bool:
        """Seen from above."""
        return self.to_scale or self.shape is not None


class Picture(NamedTuple):
    """Rows of panels, from above."""

    title: str
    rows: Sequence[Sequence[Panel]]
