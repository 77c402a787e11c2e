"""A path of lines, arcs and clothoids: pose and curvature at every length of way, and its point nearest to a place.

How this works
--------------
Along each piece the curvature grows evenly with the way (a line and an arc are clothoids too), so the heading is a
square of the way and the position the integral of its cosine and sine (Fresnel's). Each piece is cut into parts that
turn by at most 1/4 rad; within a part Gauss-Legendre quadrature with six nodes leaves less than 1e-14 of its length.
"""

from bisect import bisect_right
from collections.abc import Sequence
from math import ceil, inf
from typing import Final, NamedTuple

from gateway.arithmetic import sin_cos
from gateway.types import Pose

_TURN: Final = 0.25  # rad, of one part: the error of six nodes is (6!)^4/(13 (12!)^3) h^13 of the twelfth derivative
_NODES: Final = (  # place and half weight on 0 to 1; Abramowitz and Stegun, table 25.4, n = 6
    (0.033765242898423975, 0.0856622461895852),
    (0.16939530676686776, 0.1803807865240693),
    (0.3806904069584015, 0.2339569672863455),
    (0.6193095930415985, 0.2339569672863455),
    (0.8306046932331322, 0.1803807865240693),
    (0.966234757101576, 0.0856622461895852),
)
_SEARCH_STEP: Final = 0.1  # m, at most between the points that a search for the nearest one begins with
_HALVINGS: Final = 40


class Piece(NamedTuple):
    """A stretch of path. `corner`: rad by which the direction turns at once at its start; `words`: what it is."""

    words: str
    length: float  # m
    before: float  # curvature at its start, 1/m, positive to the left
    after: float  # and at its end
    corner: float = 0.0


class PathPoint(NamedTuple):
    """Of a path at a length of way: m, rad (continuous, not wrapped), 1/m and 1/m^2."""

    x: float
    y: float
    heading: float
    curvature: float
    slope: float  # of the curvature over the way


class _Part(NamedTuple):
    start: float  # m of way
    length: float
    x: float
    y: float
    heading: float
    curvature: float
    slope: float


def advanced(pose: Pose, curvature: float, slope: float, way: float) -> Pose:
    """After a way that turns by at most 1/4 rad: within 1e-14 of it and the rounding of the pose."""
    x, y = 0.0, 0.0
    for place, weight in _NODES:
        s = place * way
        sine, cosine = sin_cos(pose.theta + s * (curvature + 0.5 * slope * s))
        x, y = x + weight * cosine, y + weight * sine
    return Pose(pose.x + way * x, pose.y + way * y, pose.theta + way * (curvature + 0.5 * slope * way))


class Path:
    """From a start over its pieces, and straight on beyond its end. Immutable.

    `on_axle`: where the curvature jumps its direction is to turn as well, by what the chassis asks for (`rules`).
    """

    def __init__(self, start: Pose, pieces: Sequence[Piece], *, on_axle: bool = False) -> None:
        self.start = start
        self.pieces = tuple(pieces)
        self.on_axle = on_axle
        self.starts: tuple[float, ...]  # m of way, of each piece
        self._parts: list[_Part] = []
        starts, pose, way = [], start, 0.0
        for piece in self.pieces:
            starts.append(way)
            pose = Pose(pose.x, pose.y, pose.theta + piece.corner)
            if piece.length > 0.0:
                pose = self._add(piece, pose, way)
                way += piece.length
        self.starts, self.length = tuple(starts), way
        self._parts.append(_Part(way, inf, pose.x, pose.y, pose.theta, 0.0, 0.0))
        self._places = [part.start for part in self._parts]

    @property
    def sharpest(self) -> float:
        """The largest curvature, 1/m."""
        return max([max(abs(piece.before), abs(piece.after)) for piece in self.pieces], default=0.0)

    @property
    def smallest_radius(self) -> float | None:
        """m; 0.0 with a corner that is in the path itself, None of a straight line."""
        if not self.on_axle and any(piece.corner != 0.0 for piece in self.pieces):
            return 0.0
        return 1.0 / self.sharpest if self.sharpest > 0.0 else None

    def at(self, way: float) -> PathPoint:
        """The point after this way, m; the start before it."""
        way = max(way, 0.0)
        part = self._parts[bisect_right(self._places, way) - 1]
        s = way - part.start
        pose = advanced(Pose(part.x, part.y, part.heading), part.curvature, part.slope, s)
        return PathPoint(pose.x, pose.y, pose.theta, part.curvature + part.slope * s, part.slope)

    def nearest(self, x: float, y: float, *, between: tuple[float, float]) -> float:
        """Way of the point nearest to (x, y), m, among those between two ways (one of them, where several are)."""
        low, high = max(between[0], 0.0), max(between[1], 0.0)
        step = min(_SEARCH_STEP, _TURN / self.sharpest) if self.sharpest > 0.0 else _SEARCH_STEP
        count = max(1, ceil((high - low) / step))
        ways = [low + (high - low) * number / count for number in range(count + 1)]
        squares = [self._square(x, y, way) for way in ways]
        best = squares.index(min(squares))
        return self._refined(x, y, ways[max(best - 1, 0)], ways[min(best + 1, count)])

    def _refined(self, x: float, y: float, low: float, high: float) -> float:
        """Where the place lies straight beside the path: it is ahead of `low` and behind `high`, or at one of them."""
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if self.beside(x, y, middle)[0] > 0.0:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def beside(self, x: float, y: float, way: float) -> tuple[float, float]:
        """A place in the frame of the path at this way: m ahead and to the left."""
        point = self.at(way)
        sine, cosine = sin_cos(point.heading)
        dx, dy = x - point.x, y - point.y
        return cosine * dx + sine * dy, cosine * dy - sine * dx

    def _square(self, x: float, y: float, way: float) -> float:
        point = self.at(way)
        return (x - point.x) * (x - point.x) + (y - point.y) * (y - point.y)

    def _add(self, piece: Piece, pose: Pose, way: float) -> Pose:
        """The parts of a piece; the pose at its end."""
        count = max(1, ceil(max(abs(piece.before), abs(piece.after)) * piece.length / _TURN))
        length, slope = piece.length / count, (piece.after - piece.before) / piece.length
        for number in range(count):
            curvature = piece.before + slope * length * number
            self._parts.append(_Part(way + length * number, length, pose.x, pose.y, pose.theta, curvature, slope))
            pose = advanced(pose, curvature, slope, length)
        return pose
