"""What forces at the rims do to the body, and how hard the wheels together can push it in each direction.

How this works
--------------
Power is the same at the wheels and at the body, so the rows D that make rim speeds of body rates make a force on the
body of rim forces, F = D' f, and an acceleration C f with C = M^-1 D' (C_alpha of Rojas 2005, sections 2 to 4). More
wheels than axes share a push as they like: the forces of least norm are C+ a, and the kernel of C is what may be added
to them without moving anything.
What wheels of limited force can push is a zonotope, spanned by the push of each. It ends where the plane of a facet
ends it, and a facet stands on as many of those pushes as there are dimensions but one (Ziegler, Lectures on Polytopes,
section 7.3): so how far a direction goes is the least over all facets.
"""

from collections.abc import Sequence
from itertools import combinations
from math import pi, sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import angle_of, dot, sin_cos
from gateway.kinematics.contract import MAX_CONDITION
from gateway.kinematics.linear import Matrix, Vector, decompose, kernel, product, pseudo_inverse, transpose
from gateway.types import PLANAR, EffectiveMotors

_ROUNDING: Final = 1e-9  # of an acceleration that is given exactly
_TURN: Final = PLANAR.index("wz")
_STEPS: Final = 12  # in half a turn; what goes one way goes the other way too
DIRECTIONS: Final = tuple(pi * step / _STEPS for step in range(_STEPS))  # rad from forward, to the left
_DIGITS: Final = 3  # of what is told ten times a second


def force_coupling(rows: Matrix, inertia: Matrix) -> Matrix:
    """C of a = C f, a row per axis: m/s^2 and rad/s^2 per N at the rim of each wheel.

    `rows`: rim speed of each wheel per unit of each axis; of rad/s per unit the columns are per N m at the wheel.
    `inertia`: kg, kg m, kg m^2.
    """
    return product(pseudo_inverse(inertia), transpose(rows))


def least_forces(coupling: Matrix, acceleration: Sequence[float], usable: Sequence[bool]) -> Vector | None:
    """Forces of least norm of the usable wheels for exactly this acceleration, others 0; None: out of their reach."""
    kept = tuple(tuple(part for part, ok in zip(row, usable, strict=True) if ok) for row in coupling)
    if not any(usable):
        return None
    found = [dot(row, acceleration) for row in pseudo_inverse(kept)]
    scale = _ROUNDING * max(map(abs, acceleration))
    if any(abs(dot(row, found) - wanted) > scale for row, wanted in zip(kept, acceleration, strict=True)):
        return None
    forces = iter(found)
    return tuple([next(forces) if ok else 0.0 for ok in usable])


class Least(NamedTuple):
    """The smallest push of all directions, and the first direction that has it, rad from forward to the left."""

    motors: float
    direction: float


class PushTable:
    """Push of any of the motors along the ground without turning, in units of the strongest wheel alone."""

    def __init__(self, rows: Matrix, strengths: Sequence[float]) -> None:
        """`strengths`: N at the rim, or N m with rows in rad/s per unit; only their proportions count."""
        pushes = [tuple(part * strength for part in row) for row, strength in zip(rows, strengths, strict=True)]
        unit = max(sqrt(x * x + y * y) for x, y, *_ in pushes)
        lever = max(abs(push[_TURN]) for push in pushes) or 1.0  # so that a force and a moment compare
        self.unit = unit  # what 1 is: N
        self._pushes: Matrix = tuple(
            tuple(part / (lever if axis == _TURN else unit) for axis, part in enumerate(push)) for push in pushes
        )
        self._known: dict[tuple[bool, ...], tuple[Vector, Least]] = {}

    def of(self, usable: Sequence[bool]) -> EffectiveMotors:
        """Along DIRECTIONS, rounded: all motors, and the usable ones."""
        return EffectiveMotors(self._solved((True,) * len(self._pushes))[0], self._solved(tuple(usable))[0])

    def least(self, usable: Sequence[bool]) -> Least:
        """The direction in which the usable motors push least."""
        return self._solved(tuple(usable))[1]

    def along(self, direction: float, usable: Sequence[bool]) -> float:
        """Effective motors in one direction, rad from forward to the left (n of Rojas 2005, section 2)."""
        return self._zonotope(usable).reach(self._unit_vector(direction))

    def _solved(self, usable: tuple[bool, ...]) -> tuple[Vector, Least]:
        if usable not in self._known:
            zonotope = self._zonotope(usable)
            along = tuple(round(zonotope.reach(self._unit_vector(angle)), _DIGITS) for angle in DIRECTIONS)
            self._known[usable] = along, zonotope.least(self._unit_vector(0.0), self._unit_vector(pi / 2.0))
        return self._known[usable]

    def _zonotope(self, usable: Sequence[bool]) -> "_Zonotope":
        return _Zonotope([push for push, ok in zip(self._pushes, usable, strict=True) if ok], len(self._pushes[0]))

    def _unit_vector(self, direction: float) -> Vector:
        sine, cosine = sin_cos(direction)
        return (cosine, sine, *(0.0,) * (len(self._pushes[0]) - 2))


class _Zonotope:
    """All sums of these vectors, each times a factor of -1 to 1; flat where they are, a point where there are none."""

    def __init__(self, spanning: Sequence[Vector], size: int) -> None:
        found = decompose(tuple(spanning) or ((0.0,) * size,))
        rank = len([value for value in found.values if value > found.values[0] / MAX_CONDITION])
        self._span, self._rest = found.right[:rank], found.right[rank:]
        within = [_image(self._span, vector) for vector in spanning]
        self._facets = [(normal, _extent(within, normal)) for normal in _normals(within, rank)]

    def reach(self, direction: Vector) -> float:
        """The largest multiple of a direction that lies within."""
        if self._lost(direction):
            return 0.0
        inside = _image(self._span, direction)
        return min(extent / abs(rate) for normal, extent in self._facets if (rate := dot(normal, inside)) != 0.0)

    def least(self, x: Vector, y: Vector) -> Least:
        """The smallest reach of all directions in the plane of these two unit vectors at right angles.

        Each facet bounds it by extent/|rate|, and least where its rate, a cosine of the direction, is at its peak.
        """
        gone = [angle for angle, axis in ((0.0, x), (0.5 * pi, y)) if self._lost(axis)]
        if gone:
            return Least(0.0, gone[0])
        ahead, aside = _image(self._span, x), _image(self._span, y)
        peaks = []
        for normal, extent in self._facets:
            along, across = dot(normal, ahead), dot(normal, aside)
            rate = sqrt(along * along + across * across)
            if rate > 0.0:
                peaks.append(Least(extent / rate, _half_turn(angle_of(across, along))))
        smallest = min(peak.motors for peak in peaks)
        return min(
            (peak for peak in peaks if peak.motors <= smallest * (1.0 + _ROUNDING)), key=lambda peak: peak.direction
        )

    def _lost(self, direction: Vector) -> bool:
        """Whether it leads out of what the vectors span."""
        return any(abs(dot(row, direction)) > 1.0 / MAX_CONDITION for row in self._rest)


def _normals(vectors: Sequence[Vector], size: int) -> list[Vector]:
    """Of every plane that vectors of this size span together; those in one line or plane span none."""
    if size < 2:
        return [(1.0,)] * size
    found = []
    for chosen in combinations(vectors, size - 1):
        normals = (_across(chosen),) if size < 4 else kernel(chosen)
        if len(normals) == 1 and dot(normals[0], normals[0]) > 1.0 / (MAX_CONDITION * MAX_CONDITION):
            found.append(normals[0])
    return found


def _across(chosen: Sequence[Vector]) -> Vector:
    """At right angles to one vector of the plane, or to two of space."""
    if len(chosen) == 1:
        ((x, y),) = chosen
        return (-y, x)
    (a, b, c), (d, e, f) = chosen
    return (b * f - c * e, c * d - a * f, a * e - b * d)


def _extent(vectors: Sequence[Vector], normal: Vector) -> float:
    total = 0.0
    for vector in vectors:
        total += abs(dot(vector, normal))
    return total


def _image(matrix: Matrix, vector: Vector) -> Vector:
    return tuple([dot(row, vector) for row in matrix])


def _half_turn(angle: float) -> float:
    """The same line as an angle from 0 to below pi; what rounding leaves of a whole half turn is none."""
    turned = angle + pi if angle < 0.0 else angle
    return 0.0 if turned > pi - _ROUNDING or turned < _ROUNDING else turned
