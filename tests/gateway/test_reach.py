"""What is left when motors are lost: against numpy's singular values and against forces tried one by one."""

from itertools import product
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.config import parse
from gateway.core.assembly import build
from gateway.kinematics.contract import GeometryError
from gateway.kinematics.fixed_wheels import FixedWheels
from tests.world import robot_text

COORDINATE = st.floats(-1.0, 1.0)


def ring(count: int, *, first: float = pi / 4) -> FixedWheels:
    """Wheels of 0.05 m on a circle of 0.3 m, axles outwards."""
    angles = [first + 2.0 * pi * place / count for place in range(count)]
    return omni_kinematics([WheelPose(0.3 * cos(a), 0.3 * sin(a), a, 0.05) for a in angles])


@pytest.mark.parametrize(
    ("count", "lost", "effort"),
    [
        (4, (0,), 0.5),  # half the acceleration (Rojas section 11, corrected: E-001-14)
        (4, (2,), 0.5),
        (4, (), 1.0),
        (3, (), 1.0),
        (6, (5,), 0.625),
        (5, (0,), 0.5527864045),
    ],
)
def test_effort_of_rings(count: int, lost: tuple[int, ...], effort: float) -> None:
    reach = ring(count).reach([place not in lost for place in range(count)])
    assert reach.complete
    assert reach.rank == 3
    assert reach.effort == pytest.approx(effort)


@pytest.mark.parametrize(("lost", "rank"), [((0, 1), 2), ((0, 2), 2), ((0, 1, 2), 1), ((0, 1, 2, 3), 0)])
def test_lost_directions_are_those_that_turn_no_usable_wheel(lost: tuple[int, ...], rank: int) -> None:
    chassis = ring(4)
    usable = [place not in lost for place in range(4)]
    reach = chassis.reach(usable)
    assert (reach.rank, reach.complete, reach.effort) == (rank, False, 0.0)
    assert len(reach.lost) == 3 - rank
    assert np.linalg.matrix_rank(np.array(reach.lost)) == len(reach.lost)
    for direction in reach.lost:
        speeds = chassis.wheel_speeds(direction)
        assert [speed for speed, ok in zip(speeds, usable, strict=True) if ok] == pytest.approx([0.0] * sum(usable))


def test_two_opposite_wheels_lose_what_the_others_would_push() -> None:
    (direction,) = ring(4).reach([True, False, True, False]).lost
    along = np.array([cos(pi / 4), sin(pi / 4), 0.0])  # out along the axles of the two that are left
    assert abs(np.dot(along, direction)) == pytest.approx(1.0)


@pytest.mark.parametrize("usable", list(product([True, False], repeat=3)))
def test_the_offset_robot_needs_all_three(usable: tuple[bool, ...]) -> None:
    reach = build(parse(robot_text("moby"), "moby")).kinematics.reach(usable)
    assert reach.rank == sum(usable)
    assert reach.complete is all(usable)
    assert reach.effort == (1.0 if all(usable) else 0.0)


def test_without_its_joint_motor_the_offset_robot_loses_the_turn_of_its_platform() -> None:
    (direction,) = build(parse(robot_text("moby"), "moby")).kinematics.reach([True, True, False]).lost
    assert np.abs(np.array(direction) / np.linalg.norm(direction)) == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 2, st.floats(0.0, 6.28)), min_size=4, max_size=4), st.integers(0, 3)
)
def test_effort_is_the_share_that_three_wheels_can_push_of_the_worst_of_four(
    poses: list[tuple[float, float, float]], lost: int
) -> None:
    try:
        chassis = omni_kinematics([WheelPose(x, y, angle, 0.05) for x, y, angle in poses])
    except GeometryError:
        return
    reach = chassis.reach([place != lost for place in range(4)])
    rows = np.array(chassis.rim_matrix)
    kept = np.delete(rows, lost, axis=0)
    if np.linalg.cond(kept) > 1e4:
        return
    pushes = [rows.T @ np.array(signs) for signs in product([1.0, -1.0], repeat=4)]
    needed = max(np.max(np.abs(np.linalg.solve(kept.T, push))) for push in pushes)
    assert reach.effort == pytest.approx(1.0 / needed, rel=1e-6)
