"""The twists that are left when motors are lost, and the nearest of them to what is wanted.

How this works
--------------
A lost motor is free (its joint turns along) or held (its joint stands still). Held joints are constraints: the twist
lies in the kernel of their rows. Within it the usable motors push with forces R' tau, so from rest the robot comes to
move along M^-1 R' tau and no other way: directions that no usable row sees are lost, and a wheel speed commanded along
them would only be hoped for. Of the reachable twists the one that differs from the wanted one by the least kinetic
energy is the nearest (Gauss' principle of least constraint); so nobody has to weigh metres against radians.
"""

from collections.abc import Sequence
from enum import Enum
from itertools import combinations
from math import sqrt
from typing import NamedTuple

from gateway.arithmetic import dot
from gateway.kinematics.contract import MAX_CONDITION
from gateway.kinematics.linear import Matrix, Vector, decompose, product, pseudo_inverse, transpose


class JointUse(Enum):
    """What a joint is to the motion of the body."""

    USABLE = "usable"  # obeys
    FREE = "free"  # turns along with the ground
    HELD = "held"  # stands still, whatever pushes it


class Reachable(NamedTuple):
    """`basis`: twists of half a joule each, at right angles in the kinetic energy; `lost`: the same of the rest.

    `projection`: rows of the matrix that takes a wanted twist to the nearest reachable one.
    """

    basis: Matrix
    lost: Matrix
    projection: Matrix

    def nearest(self, wanted: Sequence[float]) -> Vector:
        """The reachable twist that differs least from this one."""
        return tuple([dot(row, wanted) for row in self.projection])


def reachable(rows: Matrix, uses: Sequence[JointUse], inertia: Matrix) -> Reachable:
    """What joints of these uses can do. `rows`: rad/s of each per unit of each axis; `inertia`: kg, kg m, kg m^2.

    Raises ValueError on an inertia that is not symmetric and positive definite.
    """
    size, factor = len(inertia), _cholesky(inertia)
    inverse = pseudo_inverse(factor)
    seen = product(rows, inverse)  # per unit of y = factor v, whose square is twice the kinetic energy
    longest = max(sqrt(dot(row, row)) for row in seen)
    held = [row for row, use in zip(seen, uses, strict=True) if use is JointUse.HELD]
    _, allowed = _split(held, longest, size)
    pushed = [_within(row, allowed) for row, use in zip(seen, uses, strict=True) if use is JointUse.USABLE]
    driven, rest = _split(pushed, longest, size)
    onto = product(transpose(driven), driven) if driven else ((0.0,) * size,) * size
    return Reachable(
        basis=tuple(_image(inverse, one) for one in driven),
        lost=tuple(_image(inverse, one) for one in rest),
        projection=product(product(inverse, onto), factor),
    )


def effort(rows: Matrix, uses: Sequence[JointUse], torques: Sequence[float], basis: Matrix) -> float:
    """Share of the acceleration of all motors that the usable ones give in every direction of the basis; 0 to 1.

    `torques`: N m that each motor has. What motors can push is a zonotope, spanned by one vector per motor. One lies
    within another, shrunk by this much, if it does so along every facet's normal of the other, and those are at right
    angles to all but one of its dimensions' worth of spanning vectors (Ziegler, Lectures on Polytopes, section 7.3).
    """
    every, usable = _pushes(rows, uses, torques, basis)
    if not basis or not usable:
        return 0.0
    share = 1.0
    for normal in _facets(usable, every):
        share = min(share, _extent(usable, normal) / _extent(every, normal))
    return share


def effort_along(
    rows: Matrix, uses: Sequence[JointUse], torques: Sequence[float], found: Reachable, momentum: Sequence[float]
) -> float | None:
    """The same along one motion: how much of the deceleration of all motors the usable ones give it.

    `momentum`: of that motion, N s and N m s; its size does not count. None: none of it can be braked.
    """
    every, usable = _pushes(rows, uses, torques, found.basis)
    way = [dot(one, momentum) for one in found.basis]
    square = dot(way, way)
    if square <= 0.0:
        return None
    least = sqrt(square) / MAX_CONDITION
    left, whole = _reach(usable, _facets(usable, every), way, least), _reach(every, _facets(every, every), way, least)
    return min(1.0, left / whole) if whole > 0.0 else None


def _pushes(
    rows: Matrix, uses: Sequence[JointUse], torques: Sequence[float], basis: Matrix
) -> tuple[list[Vector], list[Vector]]:
    """What all motors and the usable ones push along a basis, a vector each."""
    every = [tuple([dot(row, one) * torque for one in basis]) for row, torque in zip(rows, torques, strict=True)]
    return every, [vector for vector, use in zip(every, uses, strict=True) if use is JointUse.USABLE]


def _facets(vectors: Sequence[Vector], every: Sequence[Vector]) -> list[Vector]:
    """Normals of the facets of what these span; rounding is told by the longest of all."""
    size, longest = len(every[0]), max(sqrt(dot(vector, vector)) for vector in every)
    found = []
    for spanning in combinations(vectors, size - 1):
        _, normals = _split(spanning, longest, size)
        if len(normals) == 1:  # vectors in one line or plane bound no facet
            found.append(normals[0])
    return found


def _reach(vectors: Sequence[Vector], normals: Sequence[Vector], way: Vector | list[float], least: float) -> float:
    """The largest multiple of the way that lies in what these vectors span; 0 where no facet is seen along it."""
    rates = [(abs(dot(normal, way)), normal) for normal in normals]
    return min([_extent(vectors, normal) / rate for rate, normal in rates if rate > least], default=0.0)


def _extent(vectors: Sequence[Vector], normal: Vector) -> float:
    total = 0.0
    for vector in vectors:
        total += abs(dot(vector, normal))
    return total


def _cholesky(inertia: Matrix) -> Matrix:
    """U of M = U' U, upper triangular."""
    size = len(inertia)
    lower = [[0.0] * size for _ in range(size)]
    for row in range(size):
        for column in range(row + 1):
            left = inertia[row][column] - dot(lower[row][:column], lower[column][:column])
            if inertia[row][column] != inertia[column][row] or (row == column and not left > 0.0):
                message = f"inertia {inertia} is not symmetric and positive definite"
                raise ValueError(message)
            lower[row][column] = sqrt(left) if row == column else left / lower[column][column]
    return transpose(tuple(map(tuple, lower)))


def _within(row: Vector, basis: Matrix) -> Vector:
    """What of a row lies in the span of an orthonormal basis."""
    if not basis:
        return (0.0,) * len(row)
    return _image(transpose(basis), _image(basis, row))


def _split(vectors: Sequence[Vector], longest: float, size: int) -> tuple[Matrix, Matrix]:
    """Orthonormal bases of what these span and of the rest; up to 1e-6 of the longest counts as rounding."""
    found = decompose(tuple(vectors) or ((0.0,) * size,))
    rank = len([value for value in found.values if value > longest / MAX_CONDITION])
    return found.right[:rank], found.right[rank:]


def _image(matrix: Matrix, vector: Vector) -> Vector:
    return tuple([dot(row, vector) for row in matrix])
