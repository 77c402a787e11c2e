"""n omni wheels at arbitrary poses (Rojas 2005, sections 3-4 and 9, generalised to any wheel position and radius).

How this works
--------------
A wheel at p with its axle at angle a drives along d = (-sin a, cos a). Its rim speed is d . (v + w x p), one row of
the rim matrix D. Everything else is computed from D: wheel speeds are D v / r, the body twist is the pseudo-inverse
D+ applied to rim speeds, and what D cannot explain, (I - D D+) m, is slip. No matrix is typed in: the printed
pseudo-inverse of the paper is wrong.
"""

from collections.abc import Sequence
from math import sqrt
from typing import Final, NamedTuple, cast

from gateway.arithmetic import dot, sin_cos
from gateway.kinematics.contract import MAX_CONDITION, Estimate, GeometryError, Reach
from gateway.kinematics.linear import Matrix, condition, kernel, product, pseudo_inverse, transpose
from gateway.kinematics.reach import ReachTable
from gateway.types import Twist

_AXES: Final = 3
_INVERSE_TOLERANCE: Final = 1e-9


class WheelPose(NamedTuple):
    """Contact point (m), axle angle counter-clockwise from forward (rad), rolling radius (m)."""

    x: float
    y: float
    axis_angle: float
    radius: float


class _Solution(NamedTuple):
    """What one set of measured wheels says, per wheel speed (rad/s).

    `shares`: what each wheel adds to the twist, a column of the pseudo-inverse. `checks`: rows that any rigid motion
    takes to zero.
    """

    shares: tuple[tuple[float, float, float], ...]
    checks: Matrix


class OmniKinematics:
    """Kinematics of n omni wheels. Raises GeometryError unless the wheels have three distinct directions."""

    steered: tuple[int, ...] = ()

    def __init__(self, wheels: Sequence[WheelPose]) -> None:
        self.rim_matrix: Matrix = tuple(_rim_row(wheel) for wheel in wheels)
        self.rim_pinv = _inverse(self.rim_matrix)
        self._reach = ReachTable(self.rim_matrix)
        self._radii = tuple(wheel.radius for wheel in wheels)
        self._rows = tuple((a / r, b / r, c / r) for (a, b, c), r in zip(self.rim_matrix, self._radii, strict=True))
        self._all = (True,) * len(wheels)
        self._solutions: dict[tuple[bool, ...], _Solution | None] = {self._all: self._solve(self._all)}

    def wheel_speeds(self, twist: Twist, positions: Sequence[float | None] = ()) -> list[float]:
        """Inverse kinematics, rad/s."""
        vx, vy, wz = twist
        return [a * vx + b * vy + c * wz for a, b, c in self._rows]

    def twist(self, speeds: Sequence[float | None], positions: Sequence[float | None] = ()) -> Estimate | None:
        """Least-squares body twist of the measured wheels, with the norm of what it leaves unexplained."""
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
        square = 0.0
        for check in solution.checks:
            unexplained = dot(check, known)
            square += unexplained * unexplained
        return Estimate(Twist(vx, vy, wz), sqrt(square))

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
        return _Solution(tuple(zip(x, y, z, strict=True)), _scaled(kernel(transpose(rows)), radii))


def _rim_row(wheel: WheelPose) -> tuple[float, float, float]:
    sine, cosine = sin_cos(wheel.axis_angle)
    return -sine, cosine, cosine * wheel.x + sine * wheel.y


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
