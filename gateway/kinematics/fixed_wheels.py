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

from gateway.arithmetic import dot
from gateway.kinematics.contract import MAX_CONDITION, Estimate, GeometryError, Reach
from gateway.kinematics.linear import Matrix, Vector, condition, kernel, product, pseudo_inverse, transpose
from gateway.kinematics.reach import ReachTable
from gateway.types import Twist

_AXES: Final = 3
_INVERSE_TOLERANCE: Final = 1e-9


class _Solution(NamedTuple):
    """What one set of measured wheels says, per wheel speed (rad/s).

    `shares`: what each wheel adds to the twist, a column of the pseudo-inverse. `checks`: rows that any rigid motion
    takes to zero, m/s. `parts`: for every wheel, what of each check falls to it; None where it is not measured.
    """

    shares: tuple[tuple[float, float, float], ...]
    checks: Matrix
    parts: tuple[Vector | None, ...]


class FixedWheels:
    """Kinematics of n fixed wheels. Raises GeometryError unless they have three distinct directions.

    `rim_rows`: one for each wheel; `radii`: of the wheels, m.
    """

    steered: tuple[int, ...] = ()

    def __init__(self, rim_rows: Sequence[tuple[float, float, float]], radii: Sequence[float]) -> None:
        self.rim_matrix: Matrix = tuple(rim_rows)
        self.rim_pinv = _inverse(self.rim_matrix)
        self._reach = ReachTable(self.rim_matrix)
        self._radii = tuple(radii)
        self._rows = tuple((a / r, b / r, c / r) for (a, b, c), r in zip(self.rim_matrix, self._radii, strict=True))
        self._all = (True,) * len(self._radii)
        self._solutions: dict[tuple[bool, ...], _Solution | None] = {self._all: self._solve(self._all)}

    def wheel_speeds(self, twist: Twist, positions: Sequence[float | None] = ()) -> list[float]:
        """Inverse kinematics, rad/s."""
        vx, vy, wz = twist
        return [a * vx + b * vy + c * wz for a, b, c in self._rows]

    def twist(self, speeds: Sequence[float | None], positions: Sequence[float | None] = ()) -> Estimate | None:
        """Least-squares body twist of the measured wheels, with what it leaves unexplained, wheel by wheel."""
        if None in speeds:
            measured = tuple(speed is not None for speed in speeds)
            solution = self._solution(measured)
            known: Sequence[float] = [speed for speed in speeds if speed is not None]
        else:
            solution, known = self._solutions[self._all], cast("Sequence[float]", speeds)
        if solution is None:
            return None
        vx = vy = wz = 0.0
        for (x, y, z), speed in zip(solution.shares, known, strict=True):
            vx += x * speed
            vy += y * speed
            wz += z * speed
        if not solution.checks:
            return Estimate(Twist(vx, vy, wz), None)
        unexplained = [dot(check, known) for check in solution.checks]
        return Estimate(
            Twist(vx, vy, wz),
            sqrt(dot(unexplained, unexplained)),
            tuple([None if part is None else dot(part, unexplained) for part in solution.parts]),
        )

    def reach(self, usable: Sequence[bool]) -> Reach:
        """Three independent wheels reach every direction; the others roll along."""
        return self._reach.of(usable)

    def matrix(self, positions: Sequence[float] | None = None) -> Matrix:
        """Wheel matrix, rad/s per (m/s, m/s, rad/s)."""
        return self._rows

    def _solution(self, measured: tuple[bool, ...]) -> _Solution | None:
        if measured not in self._solutions:
            self._solutions[measured] = self._solve(measured)
        return self._solutions[measured]

    def _solve(self, measured: tuple[bool, ...]) -> _Solution | None:
        rows = tuple(row for row, known in zip(self.rim_matrix, measured, strict=True) if known)
        try:
            inverse = _inverse(rows)
        except GeometryError:
            if all(measured):
                raise
            return None
        radii = [radius for radius, known in zip(self._radii, measured, strict=True) if known]
        x, y, z = _scaled(inverse, radii)
        basis = kernel(transpose(rows))  # its projector is I - D D+
        of_known = iter(transpose(basis))
        parts = tuple(next(of_known) if known and basis else None for known in measured)
        return _Solution(tuple(zip(x, y, z, strict=True)), _scaled(basis, radii), parts)


def _scaled(rows: Matrix, factors: Sequence[float]) -> Matrix:
    """Each column times its factor."""
    return tuple(tuple(part * factor for part, factor in zip(row, factors, strict=True)) for row in rows)


def _inverse(rows: Matrix) -> Matrix:
    """D+ with D+ D = I asserted; scaled to the lever arm first so that metres and radians compare."""
    if len(rows) < _AXES:
        message = f"{len(rows)} wheel(s) cannot drive three axes"
        raise GeometryError(message)
    lever = max(abs(row[2]) for row in rows) or 1.0
    worst = condition(_scaled(rows, (1.0, 1.0, 1.0 / lever)))
    if not worst <= MAX_CONDITION:
        message = f"wheel directions are not independent: condition {worst:.3g}, allowed up to {MAX_CONDITION:.0e}"
        raise GeometryError(message)
    inverse = pseudo_inverse(rows)
    for place, row in enumerate(product(inverse, rows)):
        if any(abs(part - (column == place)) > _INVERSE_TOLERANCE for column, part in enumerate(row)):
            message = "pseudo-inverse of the wheel matrix is not its inverse"
            raise GeometryError(message)
    return inverse
