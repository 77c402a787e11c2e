"""Projection onto what the usable motors reach, against figures by hand, numpy and the laws of mechanics."""

import math
from collections.abc import Sequence
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.kinematics.linear import Matrix
from gateway.kinematics.reachable import JointUse, Reachable, effort, effort_along, reachable

USABLE, FREE, HELD = JointUse.USABLE, JointUse.FREE, JointUse.HELD
R, D1, D2 = 0.1, 0.25, 0.4  # Otbot
INERTIA = ((131.0, 0.0, 0.0), (0.0, 131.0, 0.0), (0.0, 0.0, 2.2))


def otbot(phi: float) -> Matrix:
    """Rows of left, right and platform joint by science 1.1, with the platform at heading zero."""
    along, across = (math.cos(phi), -math.sin(phi)), (math.sin(phi), math.cos(phi))
    turn = [part / D1 for part in across]
    left = [(e - w * D2 / 2) / R for e, w in zip(along, turn, strict=True)]
    right = [(e + w * D2 / 2) / R for e, w in zip(along, turn, strict=True)]
    return (*left, 0.0), (*right, 0.0), (-turn[0], -turn[1], 1.0)


def ring(angles: Sequence[float], arm: float = 0.3, radius: float = 0.06) -> Matrix:
    return tuple((-math.sin(a) / radius, math.cos(a) / radius, arm / radius) for a in angles)


FOUR = ring([math.pi / 4 + k * math.pi / 2 for k in range(4)])


def test_all_motors_reach_what_is_wanted() -> None:
    found = reachable(otbot(0.7), (USABLE, USABLE, USABLE), INERTIA)
    assert found.nearest((0.3, -0.2, 1.0)) == pytest.approx((0.3, -0.2, 1.0), abs=1e-12)
    assert found.lost == ()


@pytest.mark.parametrize("phi", [0.0, 0.7, math.pi / 2, 3.0])
def test_otbot_without_its_platform_motor_keeps_its_way_and_loses_its_yaw(phi: float) -> None:
    found = reachable(otbot(phi), (USABLE, USABLE, FREE), INERTIA)
    assert found.nearest((0.3, -0.2, 1.0)) == pytest.approx((0.3, -0.2, 0.0), abs=1e-12)
    (lost,) = found.lost
    assert lost[:2] == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("phi", [0.0, 0.7, math.pi / 2, 3.0])
def test_otbot_with_its_platform_held_turns_as_its_chassis_does(phi: float) -> None:
    """A held joint: the platform turns at (n . v)/d1, whatever else was wanted."""
    found = reachable(otbot(phi), (USABLE, USABLE, HELD), INERTIA)
    vx, vy, wz = found.nearest((0.3, -0.2, 1.0))
    assert wz == pytest.approx((math.sin(phi) * vx + math.cos(phi) * vy) / D1, abs=1e-12)
    assert len(found.basis) == 2


def test_otbot_with_one_wheel_held_turns_about_it() -> None:
    """The left wheel stands: the point where it touches the ground is the instant centre of the chassis."""
    phi = 0.4
    found = reachable(otbot(phi), (HELD, USABLE, USABLE), INERTIA)
    for vx, vy, _ in found.basis:
        turn = (math.sin(phi) * vx + math.cos(phi) * vy) / D1
        along = math.cos(phi) * vx - math.sin(phi) * vy
        assert along == pytest.approx(turn * D2 / 2, abs=1e-12)


def test_three_of_four_omni_wheels_reach_everything() -> None:
    for dead in range(4):
        uses = tuple(FREE if place == dead else USABLE for place in range(4))
        assert reachable(FOUR, uses, INERTIA).nearest((1.0, 0.5, -1.0)) == pytest.approx((1.0, 0.5, -1.0), abs=1e-12)


def test_two_opposite_wheels_push_along_one_line_and_turn() -> None:
    """Wheels 0 and 2 of the ring both roll along (-1, 1): what is across that line is lost."""
    found = reachable(FOUR, (USABLE, FREE, USABLE, FREE), INERTIA)
    assert found.nearest((1.0, 0.0, 0.5)) == pytest.approx((0.5, -0.5, 0.5), abs=1e-12)
    assert found.nearest((1.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_nothing_usable_reaches_nothing() -> None:
    for use in (FREE, HELD):
        found = reachable(FOUR, (use,) * 4, INERTIA)
        assert found.basis == ()
        assert found.nearest((1.0, 1.0, 1.0)) == (0.0, 0.0, 0.0)
        assert len(found.lost) == 3


def test_an_inertia_that_no_body_has_is_refused() -> None:
    for inertia in (((1.0, 0, 0), (0, -1.0, 0), (0, 0, 1.0)), ((1.0, 0.1, 0), (0, 1.0, 0), (0, 0, 1.0))):
        with pytest.raises(ValueError, match="not symmetric and positive definite"):
            reachable(FOUR, (USABLE,) * 4, inertia)


angles = st.lists(st.floats(0.0, 6.28).map(lambda angle: round(angle, 2)), min_size=2, max_size=6)  # nearer is one
uses_of = st.lists(st.sampled_from(JointUse), min_size=6, max_size=6)
wanted_twists = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


def inertia_of(offset: float) -> Matrix:
    """A body whose centre of mass lies ahead of its origin."""
    return ((20.0, 0.0, 0.0), (0.0, 20.0, 20.0 * offset), (0.0, 20.0 * offset, 3.0 + 20.0 * offset * offset))


def drawn(at: Sequence[float], uses: Sequence[JointUse], offset: float) -> tuple[Matrix, list[JointUse], Reachable]:
    rows, given_uses = ring(at), list(uses[: len(at)])
    return rows, given_uses, reachable(rows, given_uses, inertia_of(offset))


@settings(max_examples=200, deadline=None)
@given(angles, uses_of, st.floats(-0.5, 0.5), wanted_twists)
def test_laws_of_the_projection(
    at: list[float], uses: list[JointUse], offset: float, wanted: tuple[float, float, float]
) -> None:
    """It is reached exactly what is reachable; the error is at right angles to it in the kinetic energy."""
    rows, given_uses, found = drawn(at, uses, offset)
    mass = np.array(inertia_of(offset))
    near = np.array(found.nearest(wanted))
    assert found.nearest(tuple(near)) == pytest.approx(tuple(near), abs=1e-9)
    error = np.array(wanted) - near
    for one in found.basis:
        assert np.array(one) @ mass @ error == pytest.approx(0.0, abs=1e-8)
        assert np.array(one) @ mass @ np.array(one) == pytest.approx(1.0)
    for row, use in zip(rows, given_uses, strict=True):
        if use is HELD:
            assert np.dot(row, near) == pytest.approx(0.0, abs=1e-6 * max(1.0, float(np.abs(row).max())))
    assert len(found.basis) + len(found.lost) == 3


@settings(max_examples=200, deadline=None)
@given(angles, uses_of, st.floats(-0.5, 0.5), st.lists(st.floats(-5.0, 5.0), min_size=6, max_size=6))
def test_whatever_the_usable_motors_push_leads_into_the_reachable_twists(
    at: list[float], uses: list[JointUse], offset: float, torques: list[float]
) -> None:
    """The equation of motion with Lagrange multipliers for held joints, solved by numpy, from rest."""
    rows, given_uses, found = drawn(at, uses, offset)
    matrix = np.array(rows)
    usable = np.array([use is USABLE for use in given_uses])
    held = matrix[[use is HELD for use in given_uses]]
    force = matrix.T @ (np.array(torques[: len(at)]) * usable)
    size = len(held)
    system = np.block([[np.array(inertia_of(offset)), held.T], [held, np.zeros((size, size))]])
    if size and np.linalg.matrix_rank(held, tol=1e-3 * np.abs(held).max()) < min(size, 3):
        return  # rows that hold the same twice, nearly or exactly, have no multipliers of their own
    rate = np.linalg.lstsq(system, np.concatenate([force, np.zeros(size)]), rcond=None)[0][:3]
    assert found.nearest(tuple(rate)) == pytest.approx(tuple(rate), abs=1e-6 * (1.0 + float(np.abs(rate).max())))


def effort_of(rows: Matrix, uses: Sequence[JointUse], torques: Sequence[float]) -> float:
    return effort(rows, uses, torques, reachable(rows, uses, INERTIA).basis)


def test_effort_by_hand() -> None:
    """A ring of four without one pushes half as hard in its worst direction, one of six 0.625 times.

    Two opposite wheels still do all that can be done along their line, and half of the turning: half, then.
    """
    torques = (2.0,) * 4
    assert effort_of(FOUR, (USABLE,) * 4, torques) == pytest.approx(1.0)
    assert effort_of(FOUR, (FREE, USABLE, USABLE, USABLE), torques) == pytest.approx(0.5)
    assert effort_of(FOUR, (USABLE, FREE, USABLE, FREE), torques) == pytest.approx(0.5)
    assert effort_of(FOUR, (FREE,) * 4, torques) == 0.0
    six = ring([k * math.pi / 3 for k in range(6)])
    assert effort_of(six, (FREE, *(USABLE,) * 5), (2.0,) * 6) == pytest.approx(0.625)


def test_otbot_drives_as_hard_without_its_platform_motor_as_with_it() -> None:
    """Yaw apart: the wheels alone push it along; with the motor there the joint's torque adds a little across."""
    for phi in (0.0, 0.7, 2.0):
        share = effort_of(otbot(phi), (USABLE, USABLE, FREE), (75.0, 75.0, 229.0))
        assert 0.2 < share <= 1.0


def along(rows: Matrix, uses: Sequence[JointUse], torques: Sequence[float], way: Sequence[float]) -> float | None:
    momentum = [sum(part * rate for part, rate in zip(row, way, strict=True)) for row in INERTIA]
    return effort_along(rows, uses, torques, reachable(rows, uses, INERTIA), momentum)


def test_what_is_left_along_one_way_by_hand() -> None:
    """Rojas' 30-degree layout without one wheel: of 3.464, 1.793 and 2 effective motors 1.732, 1.414 and 1 are left.

    And without two: in line with both that are left all of it, and where they push nothing there is nothing to tell.
    """
    rows = ring([math.pi / 3, 2 * math.pi / 3, 4 * math.pi / 3, 5 * math.pi / 3])
    torques = (2.0,) * 4
    for dead, better in ((0, math.pi / 4), (1, 3 * math.pi / 4), (2, math.pi / 4), (3, 3 * math.pi / 4)):
        uses = tuple(FREE if place == dead else USABLE for place in range(4))
        assert along(rows, uses, torques, (1.0, 0.0, 0.0)) == pytest.approx(0.5)
        assert along(rows, uses, torques, (0.0, -1.0, 0.0)) == pytest.approx(0.5)
        assert along(rows, uses, torques, (0.0, 0.0, 1.0)) == pytest.approx(0.5)
        assert along(rows, uses, torques, (math.cos(better), math.sin(better), 0.0)) == pytest.approx(
            1.414 / 1.793, 1e-3
        )
    assert along(FOUR, (USABLE, FREE, USABLE, FREE), torques, (1.0, -1.0, 0.0)) == pytest.approx(1.0)
    assert along(FOUR, (USABLE, FREE, USABLE, FREE), torques, (0.0, 0.0, 2.0)) == pytest.approx(0.5)
    assert along(FOUR, (FREE,) * 4, torques, (1.0, 0.0, 0.0)) is None


@settings(max_examples=100, deadline=None)
@given(angles, uses_of, st.lists(st.floats(0.5, 5.0), min_size=6, max_size=6), wanted_twists)
def test_along_no_way_is_less_left_than_in_the_worst_one(
    at: list[float], uses: list[JointUse], torques: list[float], way: tuple[float, float, float]
) -> None:
    """And it is what numpy finds: the largest multiple of a push that they give, by a linear program."""
    rows, given_uses, found = drawn(at, uses, 0.1)
    if not found.basis:
        return
    momentum = np.array(inertia_of(0.1)) @ np.array(way)
    pushed = np.array(found.basis) @ momentum
    if np.linalg.norm(pushed) < 1e-3:
        return
    share = effort_along(rows, given_uses, torques[: len(at)], found, tuple(map(float, momentum)))
    assert share is not None
    assert share >= effort(rows, given_uses, torques[: len(at)], found.basis) - 1e-6
    seen = np.array(found.basis) @ (np.array(rows).T * np.array(torques[: len(at)]))
    usable = [use is USABLE for use in given_uses]
    left, whole = (most(seen[:, kept], pushed) for kept in (usable, [True] * len(at)))
    assert share == pytest.approx(min(1.0, left / whole), rel=1e-4)


def most(pushes: np.ndarray, way: np.ndarray) -> float:
    """The largest multiple of the way that is a sum of these, each times -1 to 1.

    At the end of a linear program all but as many factors as there are dimensions but one are at their ends.
    """
    size, best = pushes.shape[1], 0.0
    for free in combinations(range(size), min(size, len(way) - 1)):
        ends = [place for place in range(size) if place not in free]
        system = np.column_stack([way, -pushes[:, free]])
        for signs in product([1.0, -1.0], repeat=len(ends)):
            fixed = pushes[:, ends] @ np.array(signs)
            found = np.linalg.lstsq(system, fixed, rcond=None)[0]
            if np.abs(system @ found - fixed).max() < 1e-9 and np.abs(found[1:]).max(initial=0.0) <= 1.0 + 1e-9:
                best = max(best, float(found[0]))
    return best


@settings(max_examples=100, deadline=None)
@given(angles, uses_of, st.lists(st.floats(0.5, 5.0), min_size=6, max_size=6), st.integers(0, 2**32 - 1))
def test_effort_is_the_least_share_over_all_directions(
    at: list[float], uses: list[JointUse], torques: list[float], seed: int
) -> None:
    """A body within another has the smaller extent along every normal; random normals come close to the worst one."""
    rows, given_uses, found = drawn(at, uses, 0.1)
    if not found.basis:
        return
    share = effort(rows, given_uses, torques[: len(at)], found.basis)
    seen = np.array(rows) @ np.array(found.basis).T * np.array(torques[: len(at)])[:, None]
    normals = np.random.default_rng(seed).normal(size=(20_000, len(found.basis)))
    usable = np.array([use is USABLE for use in given_uses])
    shares = np.abs(seen[usable] @ normals.T).sum(axis=0) / np.abs(seen @ normals.T).sum(axis=0)
    assert share <= shares.min() * (1.0 + 1e-9)
    assert share >= shares.min() - 0.05
