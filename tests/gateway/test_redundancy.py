"""What wheels say of each other: against numpy's least squares, and the figures of Rojas 2005."""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.kinematics.linear import Matrix
from gateway.kinematics.redundancy import Check, Redundancy

RADIUS = 0.2  # m, of the robot


def ring(*degrees: float) -> Matrix:
    """Rim rows of wheels on a circle that roll along it."""
    angles = [degree * pi / 180.0 for degree in degrees]
    return tuple((-sin(angle), cos(angle), RADIUS) for angle in angles)


LAYOUTS = {
    "paper": ring(30, 150, 210, 330),
    "asymmetric": ring(33, 147, 225, 315),
    "five": ring(0, 72, 144, 216, 288),
    "six": ring(0, 60, 120, 180, 240, 300),
    "seven": ring(0, 20, 100, 160, 200, 260, 310),
}


def check_of(rows: Matrix) -> Check:
    found = Redundancy(rows).of((True,) * len(rows))
    assert found is not None
    return found


@pytest.mark.parametrize("layout", LAYOUTS)
@given(data=st.data())
def test_the_slip_of_one_wheel_and_what_it_does_to_the_motion(layout: str, data: st.DataObject) -> None:
    rows = LAYOUTS[layout]
    check, d = check_of(rows), np.array(rows)
    wheel = data.draw(st.integers(0, len(rows) - 1))
    slip = data.draw(st.floats(-2.0, 2.0))
    twist = np.array(data.draw(st.tuples(*[st.floats(-2.0, 2.0)] * 3)))
    rims = d @ twist
    rims[wheel] += slip
    told = np.linalg.lstsq(d, rims)[0]
    residuals = rims - d @ told
    assert residuals[wheel] / check.own[wheel] == pytest.approx(slip, abs=1e-9)
    assert slip * np.array(check.shares[wheel]) == pytest.approx(told - twist, abs=1e-9)
    assert np.array(check.sizes) == pytest.approx(abs(np.eye(len(rows)) - d @ np.linalg.pinv(d)), abs=1e-12)


def test_four_wheels_share_what_they_do_not_explain() -> None:
    check = check_of(LAYOUTS["paper"])
    assert check.own == pytest.approx((0.25,) * 4)
    assert [size for row in check.sizes for size in row] == pytest.approx([0.25] * 16)
    assert [share[2] for share in check.shares] == pytest.approx([0.25 / RADIUS] * 4)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (LAYOUTS["paper"], (False,) * 4),
        (LAYOUTS["asymmetric"], (False,) * 4),
        (ring(30, 150, 225, 315), (False,) * 4),
        (LAYOUTS["five"], (True,) * 5),
        (LAYOUTS["six"], (True,) * 6),
        (ring(0, 90, 180, 270, 180), (False, False, True, False, True)),  # two at one place: they check each other
    ],
)
def test_four_wheels_never_say_which_one_slips_five_and_more_do(rows: Matrix, told: Sequence[bool]) -> None:
    assert check_of(rows).told == tuple(told)


def test_three_wheels_say_nothing_of_each_other() -> None:
    assert Redundancy(ring(30, 150, 270)).of((True,) * 3) is None
    four = Redundancy(LAYOUTS["paper"])
    assert four.of((True, True, False, True)) is None
    left = Redundancy(LAYOUTS["five"]).of((True, True, True, False, True))
    assert left is not None
    assert left.places == (0, 1, 2, 4)
    assert left.told == (False,) * 4


def test_a_wheel_that_nothing_checks_leaves_no_residual() -> None:
    """Of three wheels in one line the fourth alone tells the way across."""
    rows = ((1.0, 0.0, 0.2), (1.0, 0.0, -0.2), (1.0, 0.0, 0.1), (0.0, 1.0, 0.0))
    check = check_of(rows)
    assert check.own[3] == pytest.approx(0.0, abs=1e-12)
    assert check.told[3] is False
