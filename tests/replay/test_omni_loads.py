"""What each wheel carries: statics where they say it, least squares where they do not, and wheels that lift."""

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay.sim.plants.omni_loads import Standing

SQUARE = ((0.1, 0.17), (-0.1, 0.17), (-0.1, -0.17), (0.1, -0.17))


def ring(count: int, radius: float = 0.2) -> list[tuple[float, float]]:
    return [(radius * cos(2.0 * pi * place / count), radius * sin(2.0 * pi * place / count)) for place in range(count)]


def test_three_wheels_carry_what_statics_say() -> None:
    """The one in front, twice as far from the centre as the others, half as much as both together."""
    loads = Standing(((0.2, 0.0), (-0.1, 0.1), (-0.1, -0.1))).loads(90.0)
    assert loads == pytest.approx((30.0, 30.0, 30.0))
    loads = Standing(((0.2, 0.0), (-0.05, 0.1), (-0.05, -0.1))).loads(100.0)
    assert loads == pytest.approx((20.0, 40.0, 40.0))


@pytest.mark.parametrize("count", range(3, 9))
def test_a_ring_of_wheels_shares_alike(count: int) -> None:
    assert Standing(ring(count)).loads(240.0) == pytest.approx([240.0 / count] * count)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), min_size=4, max_size=8),
    st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0)),
)
def test_it_is_the_least_norm_where_no_wheel_lifts(
    places: list[tuple[float, float]], moments: tuple[float, float]
) -> None:
    rows = np.array([[1.0, x, y] for x, y in places]).T
    if np.linalg.svd(rows)[1][-1] < 1e-2:
        return
    expected = np.linalg.pinv(rows) @ np.array((250.0, *moments))
    if expected.min() >= 0.0:
        assert Standing(places).loads(250.0, *moments) == pytest.approx(expected, abs=1e-6)


@settings(max_examples=200, deadline=None)
@given(st.floats(-40.0, 40.0), st.floats(-60.0, 60.0))
def test_no_wheel_pulls_and_the_weight_is_carried(along: float, across: float) -> None:
    """And the moments too, as long as three wheels stand."""
    loads = np.array(Standing(SQUARE).loads(250.0, along, across))
    assert loads.min() >= 0.0
    assert loads.sum() == pytest.approx(250.0)
    if np.count_nonzero(loads) >= 3:
        assert loads @ np.array(SQUARE) == pytest.approx((along, across), abs=1e-9)


def test_a_wheel_that_would_pull_is_lifted_and_the_others_share_anew() -> None:
    """Weight towards the corner behind to the left: the one across of it lifts, and three wheels are determinate."""
    loads = Standing(SQUARE).loads(250.0, -0.06 * 250.0, 0.10 * 250.0)
    assert loads[3] == 0.0
    assert min(loads[:3]) > 1.0
    expected = np.linalg.solve(np.array([[1.0, x, y] for x, y in SQUARE[:3]]).T, (250.0, -0.06 * 250.0, 0.10 * 250.0))
    assert loads[:3] == pytest.approx(expected)


def test_a_robot_that_would_tip_over_stands_on_what_is_left() -> None:
    assert Standing(SQUARE).loads(250.0, -0.2 * 250.0) == pytest.approx((0.0, 125.0, 125.0, 0.0))


def test_it_changes_without_a_jump_up_to_there_and_beyond() -> None:
    before = Standing(SQUARE).loads(250.0)
    for step in range(1, 400):
        loads = Standing(SQUARE).loads(250.0, -0.1 * step, 0.12 * step)
        assert max(abs(new - old) for new, old in zip(loads, before, strict=True)) < 2.5
        before = loads


@pytest.mark.parametrize("places", [((0.0, 0.0), (1.0, 0.0), (2.0, 0.0)), ((0.0, 1.0),) * 4, ((1.0, 1.0), (2.0, 2.0))])
def test_wheels_in_one_line_are_refused(places: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ValueError, match="one line"):
        Standing(places)
