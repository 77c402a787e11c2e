"""Linear algebra of small matrices with the same bits on every CPU: no BLAS, no LAPACK, a fixed order of operations.

How this works
--------------
Everything follows from the singular values and vectors, found by one-sided Jacobi rotations (Hestenes 1958; Golub and
Van Loan, Matrix Computations, section 8.6.3): pairs of columns are turned in their plane until all columns are at right
angles. What was turned is V, the turned columns are A V, their lengths are the singular values. Slower than LAPACK for
large matrices, for those of a chassis (up to 16 wheels, 3 or 4 axes) a fraction of a millisecond, and more exact.
"""

from math import inf, sqrt
from typing import Final, NamedTuple

from gateway.arithmetic import dot

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]  # its rows

_EPSILON: Final = 2.220446049250313e-16  # distance from 1 to the next float
_SWEEPS: Final = 40  # it takes five to eight; each squares what is left of the angles


class Decomposition(NamedTuple):
    """A v_i = s_i u_i, the largest s first; `images` are the s_i u_i, `right` the v_i: as many as there are columns."""

    values: Vector
    images: Matrix
    right: Matrix
    rank: int  # number of values that are more than rounding: max(rows, columns) * 2.2e-16 of the matrix' norm


def decompose(matrix: Matrix) -> Decomposition:
    """Singular values and vectors of any matrix with a row and a column; entries below 1e-150 count as zero."""
    columns = [list(column) for column in zip(*matrix, strict=True)]
    size = len(columns)
    right = [[1.0 if row == column else 0.0 for row in range(size)] for column in range(size)]
    share = max(size, len(matrix)) * _EPSILON
    null = share * sqrt(dot([dot(column, column) for column in columns], [1.0] * size))
    for _ in range(_SWEEPS):
        turned = [
            _turn(columns, right, first, second, null) for first in range(size) for second in range(first + 1, size)
        ]
        if not any(turned):
            break
    values = [sqrt(dot(column, column)) for column in columns]
    order = sorted(range(size), key=lambda place: -values[place])
    return Decomposition(
        values=tuple(values[place] for place in order),
        images=tuple(tuple(columns[place]) for place in order),
        right=tuple(tuple(right[place]) for place in order),
        rank=len([value for value in values if value > null]),
    )


def pseudo_inverse(matrix: Matrix) -> Matrix:
    """The Moore-Penrose inverse: least squares where there are more rows, least norm where there are fewer."""
    found = decompose(matrix)
    used = range(found.rank)
    images = [[part / found.values[i] for part in found.images[i]] for i in used]
    right = [[part / found.values[i] for part in found.right[i]] for i in used]
    return tuple(
        tuple(dot([v[row] for v in right], [u[column] for u in images]) for column in range(len(matrix)))
        for row in range(len(matrix[0]))
    )


def kernel(matrix: Matrix) -> Matrix:
    """Orthonormal basis of the vectors that the matrix takes to zero; empty where there is none but zero itself."""
    found = decompose(matrix)
    return found.right[found.rank :]


def condition(matrix: Matrix) -> float:
    """Largest over smallest singular value; infinite for a matrix that takes a direction to exactly zero."""
    values = decompose(matrix).values[: min(len(matrix), len(matrix[0]))]
    return values[0] / values[-1] if values[-1] > 0.0 else inf


def diagonal(values: Vector) -> Matrix:
    """These on the diagonal, zeros beside it."""
    places = range(len(values))
    return tuple(tuple(value if place == row else 0.0 for place in places) for row, value in enumerate(values))


def transpose(matrix: Matrix) -> Matrix:
    """Rows for columns."""
    return tuple(zip(*matrix, strict=True))


def product(matrix: Matrix, other: Matrix) -> Matrix:
    """The matrix product."""
    columns = transpose(other)
    return tuple(tuple(dot(row, column) for column in columns) for row in matrix)


def _turn(columns: list[list[float]], right: list[list[float]], first: int, second: int, null: float) -> bool:
    """Put two columns at right angles; whether that was needed. Columns up to `null` long are zero."""
    a, b = columns[first], columns[second]
    square_a, square_b, mixed = dot(a, a), dot(b, b), dot(a, b)
    length_a, length_b = sqrt(square_a), sqrt(square_b)
    if min(length_a, length_b) <= null or abs(mixed) <= 4.0 * _EPSILON * length_a * length_b:
        return False
    slope = (square_b - square_a) / (2.0 * mixed)
    tangent = 1.0 / (abs(slope) + sqrt(1.0 + slope * slope))
    if slope < 0.0:
        tangent = -tangent
    cosine = 1.0 / sqrt(1.0 + tangent * tangent)
    for vectors in (columns, right):
        one, two = vectors[first], vectors[second]
        vectors[first] = [cosine * (x - tangent * y) for x, y in zip(one, two, strict=True)]
        vectors[second] = [cosine * (y + tangent * x) for x, y in zip(one, two, strict=True)]
    return True
