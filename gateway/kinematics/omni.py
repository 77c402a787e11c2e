"""n omni wheels at arbitrary poses (Rojas 2005, sections 3-4 and 9, generalised to any wheel position and radius).

How this works
--------------
A wheel at p with its axle at angle a drives along d = (-sin a, cos a). Its rim speed is d . (v + w x p), one row of
the rim matrix D. Everything else is computed from D: wheel speeds are D v / r, the body twist is the pseudo-inverse
D+ applied to rim speeds, and what D cannot explain, (I - D D+) m, is slip. No matrix is typed in: the printed
pseudo-inverse of the paper is wrong.
"""

from collections.abc import Sequence
from math import cos, hypot, sin
from operator import mul
from typing import NamedTuple, cast

import numpy as np

from gateway.kinematics.contract import MAX_CONDITION, Estimate, GeometryError, Matrix
from gateway.types import Twist

_AXES = 3


class WheelPose(NamedTuple):
    """Contact point (m), axle angle counter-clockwise from forward (rad), rolling radius (m)."""

    x: float
    y: float
    axis_angle: float
    radius: float


class _Solution(NamedTuple):
    """Pseudo-inverse and consistency rows of one set of measured wheels, per wheel speed (rad/s)."""

    to_twist: tuple[tuple[float, ...], ...]
    checks: tuple[tuple[float, ...], ...]


class OmniKinematics:
    """Kinematics of n omni wheels. Raises GeometryError unless the wheels have three distinct directions."""

    steered: tuple[int, ...] = ()

    def __init__(self, wheels: Sequence[WheelPose]) -> None:
        self.rim_matrix = np.array([_rim_row(wheel) for wheel in wheels], dtype=np.float64)
        self.rim_pinv = _pseudo_inverse(self.rim_matrix)
        self.slip_projector: Matrix = np.eye(len(wheels)) - self.rim_matrix @ self.rim_pinv
        self._radii = tuple(wheel.radius for wheel in wheels)
        self._rows = tuple(
            (a / r, b / r, c / r) for (a, b, c), r in zip(self.rim_matrix.tolist(), self._radii, strict=True)
        )
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
            known = [speed for speed in speeds if speed is not None]
        else:
            solution, known = self._solutions[self._all], cast("list[float]", speeds)
        if solution is None:
            return None
        x, y, z = solution.to_twist
        twist = Twist(sum(map(mul, x, known)), sum(map(mul, y, known)), sum(map(mul, z, known)))
        if not solution.checks:
            return Estimate(twist, None)
        return Estimate(twist, hypot(*[sum(map(mul, check, known)) for check in solution.checks]))

    def drivable(self, usable: Sequence[bool]) -> bool:
        """Three independent wheels reach every direction; the others roll along."""
        return self._solution(tuple(usable)) is not None

    def matrix(self) -> Matrix:
        """Wheel matrix, rad/s per (m/s, m/s, rad/s)."""
        return np.array(self._rows)

    def _solution(self, measured: tuple[bool, ...]) -> _Solution | None:
        if measured not in self._solutions:
            self._solutions[measured] = self._solve(measured)
        return self._solutions[measured]

    def _solve(self, measured: tuple[bool, ...]) -> _Solution | None:
        rows = self.rim_matrix[list(measured)]
        try:
            inverse = _pseudo_inverse(rows)
        except GeometryError:
            if all(measured):
                raise
            return None
        left, _, _ = np.linalg.svd(rows)
        radii = np.array(self._radii)[list(measured)]
        inverse, checks = inverse * radii, left[:, _AXES:].T * radii
        return _Solution(tuple(map(tuple, inverse.tolist())), tuple(map(tuple, checks.tolist())))


def _rim_row(wheel: WheelPose) -> tuple[float, float, float]:
    drive_x, drive_y = -sin(wheel.axis_angle), cos(wheel.axis_angle)
    return drive_x, drive_y, drive_y * wheel.x - drive_x * wheel.y


def _pseudo_inverse(rows: Matrix) -> Matrix:
    """D+ with D+ D = I asserted; scaled to the lever arm first so that metres and radians compare."""
    if len(rows) < _AXES:
        message = f"{len(rows)} wheel(s) cannot drive three axes"
        raise GeometryError(message)
    lever = float(np.max(np.abs(rows[:, 2]))) or 1.0
    condition = float(np.linalg.cond(rows / [1.0, 1.0, lever]))
    if not condition <= MAX_CONDITION:
        message = f"wheel directions are not independent: condition {condition:.3g}, allowed up to {MAX_CONDITION:.0e}"
        raise GeometryError(message)
    inverse = np.asarray(np.linalg.pinv(rows), dtype=np.float64)
    if not np.allclose(inverse @ rows, np.eye(_AXES), atol=1e-9):
        message = "pseudo-inverse of the wheel matrix is not its inverse"
        raise GeometryError(message)
    return inverse
