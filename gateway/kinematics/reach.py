"""What the motors that are left can still do: the directions they drive, and how hard in the worst of them."""

from collections.abc import Iterator, Sequence
from itertools import combinations

from gateway.arithmetic import dot
from gateway.kinematics.contract import MAX_CONDITION, Reach
from gateway.kinematics.linear import Matrix, Vector, decompose, kernel
from gateway.types import Twist


class ReachTable:
    """Reach of every set of motors, from the rows of the wheels (m/s at the rim per m/s, m/s and rad/s of the body)."""

    def __init__(self, rows: Matrix) -> None:
        self._rows = rows
        self._lever = max(abs(row[2]) for row in rows) or 1.0  # m; so that metres and radians compare
        self._known: dict[tuple[bool, ...], Reach] = {}

    def of(self, usable: Sequence[bool]) -> Reach:
        """Reach of the usable motors, each pushing with the same force at its rim."""
        key = tuple(usable)
        if key not in self._known:
            self._known[key] = self._compute(key)
        return self._known[key]

    def _compute(self, usable: tuple[bool, ...]) -> Reach:
        kept = [row for row, ok in zip(self._rows, usable, strict=True) if ok]
        lost = self._lost(kept)
        return Reach(len(self._rows[0]) - len(lost), lost, 0.0 if lost else self._effort(kept))

    def _lost(self, kept: Sequence[Vector]) -> tuple[Twist, ...]:
        lever = self._lever
        if not kept:
            size = len(self._rows[0])
            return tuple(Twist(*[float(row == axis) for axis in range(3)]) for row in range(size))
        found = decompose(tuple((x, y, z / lever, *more) for x, y, z, *more in kept))
        weak = found.values[0] / MAX_CONDITION
        return tuple(
            Twist(x, y, z / lever)
            for value, (x, y, z, *_) in zip(found.values, found.right, strict=True)
            if not value > weak
        )

    def _effort(self, kept: Sequence[Vector]) -> float:
        """How far the body of forces of all motors has to shrink to lie within that of the usable ones.

        Both are zonotopes spanned by the rows. One lies in the other if it does so along every facet's normal of the
        other, and those stand on as many of its rows as there are axes but one; of three axes they are cross
        products of rows (Ziegler, Lectures on Polytopes, section 7.3).
        """
        effort = 1.0
        for normal in _normals(kept):
            every = _extent(self._rows, normal)
            if every > 0.0:
                effort = min(effort, _extent(kept, normal) / every)
        return effort


def _extent(rows: Sequence[Vector], normal: Vector) -> float:
    total = 0.0
    for row in rows:
        total += abs(dot(row, normal))
    return total


def _normals(rows: Sequence[Vector]) -> Iterator[Vector]:
    axes = len(rows[0])
    for chosen in combinations(rows, axes - 1):
        if axes == 3:
            yield _cross(chosen[0], chosen[1])
        else:
            normals = kernel(chosen)
            if len(normals) == 1:
                yield normals[0]


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
