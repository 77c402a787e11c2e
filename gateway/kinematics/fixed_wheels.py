"""Wheels whose geometry no joint angle changes: everything from one row per wheel.

How this works
--------------
A row of the rim matrix D is the rim speed of one wheel per m/s, m/s and rad/s of the body. Wheel speeds are D v / r,
the body twist is the pseudo-inverse D+ applied to rim speeds, and what D cannot explain, (I - D D+) m, is slip (Rojas
2005, sections 3-4 and 9).
"""

from collections.abc import Sequence
from math import sqrt
from typing import Final, NamedTuple, cast

from drivers.records import maker
from gateway.arithmetic import dot
from gateway.kinematics.contract import MAX_CONDITION, Estimate, GeometryError, Reach
from gateway.kinematics.linear import Matrix, Vector, condition, kernel, product, pseudo_inverse, transpose
from gateway.kinematics.reach import ReachTable
from gateway.kinematics.undriven import Beyond, refusal
from gateway.types import PLANAR, Rates, Twist

_TURN: Final = PLANAR.index("wz")  # the axis in rad/s
_twist: Final = maker(Twist)
_estimate: Final = maker(Estimate)
_INVERSE_TOLERANCE: Final = 1e-9


class _Solution(NamedTuple):
    """What one set of measured wheels says, per wheel speed (rad/s).

    `shares`: what each wheel adds to the twist, a column of the pseudo-inverse. `checks`: rows that any rigid motion
    takes to zero, m/s, and what of it falls to each wheel. `more`: rows of the inverse for axes beyond the twist.
    """

    shares: tuple[tuple[float, float, float], ...]
    more: Matrix
    checks: tuple[tuple[Vector, Vector], ...]


class FixedWheels:
    """Kinematics of n fixed wheels. Raises GeometryError unless they have three distinct directions.

    `rim_rows`: one for each wheel, m/s at the rim per unit of each axis; `radii`: of the wheels, m.
    """

    steered: tuple[int, ...] = ()

    def __init__(self, rim_rows: Sequence[Vector], radii: Sequence[float], *, axes: tuple[str, ...] = PLANAR) -> None:
        self.axes = axes
        self.rim_matrix: Matrix = tuple(rim_rows)
        self.rim_pinv = _inverse(self.rim_matrix, radii)
        self._reach = ReachTable(self.rim_matrix)
        self.radii = tuple(radii)
        self._rows = tuple(tuple(part / r for part in row) for row, r in zip(self.rim_matrix, self.radii, strict=True))
        self._all = (True,) * len(self.radii)
        self._solutions: dict[tuple[bool, ...], _Solution | None] = {self._all: self._solve(self._all)}

    def wheel_speeds(self, rates: Rates, positions: Sequence[float | None] = ()) -> list[float]:
        """Inverse kinematics, rad/s."""
        if len(rates) > len(PLANAR):
            return [dot(row, rates) for row in self._rows]
        vx, vy, wz = rates
        return [a * vx + b * vy + c * wz for a, b, c in self._rows]

    def twist(self, speeds: Sequence[float | None], positions: Sequence[float | None] = ()) -> Estimate | None:
        """Least-squares body twist of the measured wheels, with what it leaves unexplained, wheel by wheel."""
        solution, known = self._measured(speeds)
        if solution is None:
            return None
        twist = _fitted(solution, known)
        more = tuple([dot(row, known) for row in solution.more]) if solution.more else ()
        if not solution.checks:
            return _estimate((twist, None, None, more))
        square = 0.0
        residuals: list[float] = []
        for check, parts in solution.checks:
            unexplained = dot(check, known)
            square += unexplained * unexplained
            falling = [part * unexplained for part in parts]
            residuals = [a + b for a, b in zip(residuals, falling)] if residuals else falling
        return _estimate((twist, sqrt(square), self._placed(residuals, speeds), more))

    def motion(self, speeds: Sequence[float | None], positions: Sequence[float | None] = ()) -> Twist | None:
        """The same without what it leaves unexplained, in half the time."""
        solution, known = self._measured(speeds)
        return None if solution is None else _fitted(solution, known)

    def reach(self, usable: Sequence[bool]) -> Reach:
        """Three independent wheels reach every direction; the others roll along."""
        return self._reach.of(usable)

    def matrix(self, positions: Sequence[float] | None = None) -> Matrix:
        """Wheel matrix, rad/s per unit of each axis."""
        return self._rows

    @staticmethod
    def _placed(residuals: Sequence[float], speeds: Sequence[float | None]) -> tuple[float | None, ...]:
        """Those of the measured wheels in the places of these; None between them."""
        if len(residuals) == len(speeds):
            return tuple(residuals)
        following = iter(residuals)
        return tuple([None if speed is None else next(following) for speed in speeds])

    def _measured(self, speeds: Sequence[float | None]) -> tuple[_Solution | None, Sequence[float]]:
        """Those that are known, and what follows from them."""
        if None not in speeds:
            return self._solutions[self._all], cast("Sequence[float]", speeds)
        known = [speed for speed in speeds if speed is not None]
        return self._solution(tuple([speed is not None for speed in speeds])), known

    def _solution(self, measured: tuple[bool, ...]) -> _Solution | None:
        if measured not in self._solutions:
            self._solutions[measured] = self._solve(measured)
        return self._solutions[measured]

    def _solve(self, measured: tuple[bool, ...]) -> _Solution | None:
        rows = tuple(row for row, known in zip(self.rim_matrix, measured, strict=True) if known)
        radii = [radius for radius, known in zip(self.radii, measured, strict=True) if known]
        try:
            inverse = _inverse(rows, radii)
        except GeometryError:
            if all(measured):
                raise
            return None
        x, y, z, *more = _scaled(inverse, radii)
        basis = kernel(transpose(rows))  # its projector is I - D D+
        return _Solution(
            shares=tuple(zip(x, y, z, strict=True)),
            more=tuple(more),
            checks=tuple(zip(_scaled(basis, radii), basis, strict=True)),
        )


def _fitted(solution: _Solution, known: Sequence[float]) -> Twist:
    """Least squares: what each wheel adds, added up."""
    vx = vy = wz = 0.0
    for (x, y, z), speed in zip(solution.shares, known):
        vx += x * speed
        vy += y * speed
        wz += z * speed
    return _twist((vx, vy, wz))


def _scaled(rows: Matrix, factors: Sequence[float]) -> Matrix:
    """Each column times its factor."""
    return tuple(tuple(part * factor for part, factor in zip(row, factors, strict=True)) for row in rows)


def _inverse(rows: Matrix, radii: Sequence[float]) -> Matrix:
    """D+ with D+ D = I asserted; scaled to the lever arm first so that metres and radians compare.

    A lever far below the radius of the wheels is none: their rollers all push towards one point.
    """
    axes = len(rows[0]) if rows else len(PLANAR)
    if len(rows) < axes:
        message = f"{len(rows)} wheel(s) cannot drive {axes} axes"
        raise GeometryError(message)
    lever = max([abs(row[_TURN]) for row in rows] + list(radii))
    worst = condition(_scaled(rows, [1.0 / lever if axis == _TURN else 1.0 for axis in range(axes)]))
    if not worst <= MAX_CONDITION:
        beyond = [Beyond(f"change axis {axis}", f"changing axis {axis}") for axis in range(len(PLANAR), axes)]
        raise GeometryError(f"wheel directions are not independent: {refusal(rows, lever, beyond=beyond)}")
    inverse = pseudo_inverse(rows)
    for place, row in enumerate(product(inverse, rows)):
        if any(abs(part - (column == place)) > _INVERSE_TOLERANCE for column, part in enumerate(row)):
            message = "pseudo-inverse of the wheel matrix is not its inverse"
            raise GeometryError(message)
    return inverse
