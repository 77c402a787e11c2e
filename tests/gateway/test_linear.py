"""Small linear algebra against numpy, and the laws that each result obeys whatever numpy says."""

import itertools
import math
import random

import numpy as np
import numpy.typing as npt
import pytest

from gateway.arithmetic import dot
from gateway.kinematics.linear import (
    Matrix,
    condition,
    decompose,
    kernel,
    product,
    pseudo_inverse,
    transpose,
)

Array = npt.NDArray[np.float64]


def _drawn(seed: int) -> Matrix:
    """Up to 16 rows or columns and 4 of the other; in every second the last column is a sum of others."""
    generator = random.Random(seed)
    rows, columns = generator.randint(1, 16), generator.randint(1, 4)
    found = [[generator.uniform(-3.0, 3.0) for _ in range(columns)] for _ in range(rows)]
    if seed % 2:
        for row in found:
            row[-1] = row[0] - 2.0 * row[columns // 2]
    matrix = tuple(map(tuple, found))
    return transpose(matrix) if seed % 3 else matrix


MATRICES = [
    *map(_drawn, range(80)),
    ((0.0, 0.0), (0.0, 0.0)),
    ((1.0, 1.0), (1.0, 1.0), (1.0, 1.0)),
    ((1.0, 0.0, 1e-4), (0.0, 1.0, 0.0), (0.0, 10.0, 1.0)),
]
every_matrix = pytest.mark.parametrize("matrix", MATRICES, ids=itertools.count())


def known_rank(matrix: Matrix) -> int | None:
    """None where a small singular value might be one of rounding."""
    values = np.linalg.svd(np.array(matrix), compute_uv=False)
    shares = values / values[0] if values[0] > 0.0 else values
    if any(1e-13 < share < 1e-6 for share in shares):
        return None
    return int((shares > 1e-6).sum())


@every_matrix
def test_singular_values_are_those_of_numpy(matrix: Matrix) -> None:
    expected = np.linalg.svd(np.array(matrix), compute_uv=False)
    values = decompose(matrix).values
    assert values[: len(expected)] == pytest.approx(expected.tolist(), abs=1e-14 * (1.0 + expected[0]))
    assert all(value <= 1e-14 * (1.0 + expected[0]) for value in values[len(expected) :])


@every_matrix
def test_vectors_are_orthonormal_and_give_the_matrix_back(matrix: Matrix) -> None:
    found = decompose(matrix)
    array, right, images = np.array(matrix), np.array(found.right), np.array(found.images)
    assert right @ right.T == pytest.approx(np.eye(len(right)), abs=1e-14)
    assert images.T @ right == pytest.approx(array, abs=3e-14)
    assert array @ right.T == pytest.approx(images.T, abs=3e-14)


@every_matrix
def test_pseudo_inverse(matrix: Matrix) -> None:
    """The four conditions of Penrose (1955), and numpy's, where rounding does not decide what the rank is."""
    if known_rank(matrix) is None:
        return
    a, inverse = np.array(matrix), np.array(pseudo_inverse(matrix))
    scale = 1.0 + float(np.max(np.abs(inverse)))
    assert inverse == pytest.approx(np.linalg.pinv(a, rcond=1e-13), abs=1e-11 * scale * scale)
    for product_, symmetric in ((a @ inverse @ a, None), (a @ inverse, True), (inverse @ a, True)):
        expected = a if symmetric is None else product_.T
        assert product_ == pytest.approx(expected, abs=1e-11 * scale)


@every_matrix
def test_kernel_rank_and_condition(matrix: Matrix) -> None:
    expected = known_rank(matrix)
    if expected is None:
        return
    basis = kernel(matrix)
    assert decompose(matrix).rank == expected
    assert len(basis) == len(matrix[0]) - expected
    for one in basis:
        assert all(abs(dot(row, one)) < 1e-13 for row in matrix)
    if expected == min(len(matrix), len(matrix[0])):
        assert condition(matrix) == pytest.approx(float(np.linalg.cond(np.array(matrix))), rel=1e-8)
    else:
        assert condition(matrix) > 1e12


def test_by_hand() -> None:
    """A rotation by 3-4-5 of diag(5, 10): values 10 and 5; the row (1, 2) has norm sqrt 5 and inverse (1, 2)/5."""
    turned = ((3.0, -8.0), (4.0, 6.0))
    assert decompose(turned).values == pytest.approx((10.0, 5.0), abs=1e-15)
    assert condition(turned) == pytest.approx(2.0)
    assert np.array(pseudo_inverse(((1.0, 2.0),))) == pytest.approx(np.array([[0.2], [0.4]]))
    ((first, second),) = kernel(((1.0, 2.0),))
    assert first == pytest.approx(-2.0 * second)
    assert abs(second) == pytest.approx(1.0 / math.sqrt(5.0))
    assert decompose(((0.0, 0.0),)).rank == 0
    assert condition(((1.0, 0.0), (0.0, 0.0))) == math.inf
    assert product(((1.0, 2.0),), ((3.0,), (4.0,))) == ((11.0,),)
