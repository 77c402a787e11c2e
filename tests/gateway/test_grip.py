"""What the floor gives, against a linear program over the wheels' forces and figures measured on another plant."""

from collections.abc import Sequence
from itertools import combinations
from math import cos, hypot, inf, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.control.grip import Grip, GripError, Push, part_of, room

MASS, INERTIA, HEIGHT, RADIUS, ROTOR = 25.0, 0.9, 0.10, 0.0762, 0.004  # omni4; kg, kg m^2, m, m, kg m^2
WEIGHT = 25.0 * 9.81
Pose = tuple[float, float, float]  # x, y, angle of the axle
Three = tuple[float, float, float]


def ring(angles: Sequence[float], radius: float = 0.2) -> tuple[Pose, ...]:
    return tuple((radius * cos(angle), radius * sin(angle), angle) for angle in angles)


OMNI4 = ring([pi / 3, 2 * pi / 3, 4 * pi / 3, 5 * pi / 3])
LAYOUTS: dict[str, tuple[Pose, ...]] = {
    "omni4": OMNI4,
    "three": ring([0.0, 2 * pi / 3, 4 * pi / 3]),
    "asymmetric": ring([0.6, pi - 0.9, pi + 0.9, -0.6]),
    "plus": ((0.0, 0.2, pi / 2), (0.0, -0.2, pi / 2), (-0.2, 0.0, 0.0), (0.2, 0.0, 0.0)),
    "five": ring([2 * pi * k / 5 for k in range(5)], 0.3),
    "six": ring([pi / 6 + pi * k / 3 for k in range(6)], 0.3),
    "eccentric": ((0.25, 0.15, 1.0), (-0.1, 0.2, 2.3), (-0.15, -0.2, 4.0), (0.1, -0.22, 5.5)),
    "doubled": (*OMNI4, (0.12, 0.12 * sqrt(3.0), pi / 3)),  # two wheels on one axle
    "row": (*ring([0.5, pi - 0.5, pi + 0.5, -0.5]), (0.0, 0.1, pi / 2), (0.0, -0.15, pi / 2), (0.0, 0.0, pi / 2)),
}


def rows(poses: Sequence[Pose]) -> list[Three]:
    return [(-sin(a), cos(a), cos(a) * x + sin(a) * y) for x, y, a in poses]


def grip(poses: Sequence[Pose], height: float = HEIGHT) -> Grip:
    return Grip(rows(poses), [(x, y) for x, y, _ in poses], mass=MASS, inertia=INERTIA, height=height)


def least_norm(
    poses: Sequence[Pose], ax: float, ay: float, height: float = HEIGHT
) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Loads of equal springs under a rigid body, all in contact: balance of force and of two moments."""
    balance = np.array([[1.0, x, y] for x, y, _ in poses]).T
    wanted = np.array([WEIGHT, -MASS * height * ax, -MASS * height * ay])
    return np.asarray(np.linalg.lstsq(balance, wanted, rcond=None)[0])


def furthest(poses: Sequence[Pose], direction: Sequence[float], friction: float, height: float = HEIGHT) -> float:
    """Linear program, by its vertices: the most s with D'f = s M d, |f| <= mu N(s d) and N >= 0."""
    count = len(poses)
    base = least_norm(poses, 0.0, 0.0, height)
    slope = least_norm(poses, direction[0], direction[1], height) - base
    matrix = np.array(rows(poses))
    equal = np.hstack([matrix.T, -(np.array([MASS, MASS, INERTIA]) * direction)[:, None]])
    eye = np.eye(count)
    most = np.vstack([np.hstack([eye, -friction * slope[:, None]]), np.hstack([-eye, -friction * slope[:, None]])])
    bound = friction * np.concatenate([base, base])
    best = 0.0
    for active in combinations(range(2 * count), count - 2):
        system = np.vstack([equal, most[list(active)]])
        if abs(np.linalg.det(system)) < 1e-9:
            continue
        corner = np.linalg.solve(system, np.concatenate([np.zeros(3), bound[list(active)]]))
        if np.all(most @ corner <= bound + 1e-7):
            best = max(best, float(corner[-1]))
    lifting = [-load / change for load, change in zip(base, slope, strict=True) if change < 0.0]
    return min(best, *lifting) if lifting else best


def limits(one: Grip, friction: float) -> list[Three]:
    return [*[cone.limit for cone in one.cones(friction)], *one.lifting()]


directions = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-5, 5)).filter(lambda d: hypot(*d) > 0.1)


@pytest.mark.parametrize("name", [name for name in LAYOUTS if name != "row"])
@settings(max_examples=25, deadline=None)
@given(direction=directions, friction=st.sampled_from([0.1, 0.3, 0.8, 1.2]))
def test_the_limits_are_those_of_the_linear_program(name: str, direction: Three, friction: float) -> None:
    poses = LAYOUTS[name]
    part = part_of(limits(grip(poses), friction), direction)
    assert 1.0 / part == pytest.approx(furthest(poses, direction, friction), rel=1e-6)


@pytest.mark.parametrize("name", LAYOUTS)
@settings(max_examples=40, deadline=None)
@given(direction=directions, size=st.floats(0.05, 1.0), friction=st.sampled_from([0.1, 0.3, 0.8]))
def test_shared_forces_do_it_and_no_other_forces_use_less(
    name: str, direction: Three, size: float, friction: float
) -> None:
    poses = LAYOUTS[name]
    one = grip(poses)
    factor = size / part_of(limits(one, friction), direction)
    acceleration = [part * factor for part in direction]
    share = one.shared(acceleration, friction)
    matrix, loads = np.array(rows(poses)), np.array(one.loads(acceleration[0], acceleration[1]))
    wrench = np.array([MASS, MASS, INERTIA]) * acceleration
    assert matrix.T @ share.forces == pytest.approx(wrench, abs=1e-7)
    used = np.abs(share.forces) / (friction * loads)
    assert max(used) == pytest.approx(share.use, rel=1e-6)
    assert share.use <= 1.0 + 1e-9
    # Weak duality: for any y, |y . w| <= sum c |row . y| times the use, and the best facet attains it.
    dual = max(
        abs(normal @ wrench) / float(friction * loads @ np.abs(matrix @ normal))
        for a, b in combinations(matrix, 2)
        if np.linalg.norm(normal := np.cross(a, b)) > 1e-9
    )
    assert share.use == pytest.approx(dual, rel=1e-6)


@pytest.mark.parametrize("name", LAYOUTS)
@settings(max_examples=40, deadline=None)
@given(direction=directions, size=st.floats(0.05, 1.0), friction=st.sampled_from([0.1, 0.3, 0.8]))
def test_in_proportion_every_wheel_still_grips(name: str, direction: Three, size: float, friction: float) -> None:
    poses = LAYOUTS[name]
    one = grip(poses)
    cone = max(one.cones(friction), key=lambda cone: float(np.dot(cone.limit, direction)))
    factor = 1.0 / max(float(np.dot(cone.limit, direction)), part_of(one.lifting(), direction))
    furthest_of = np.array(direction) * factor
    forces = np.array(cone.forces) @ furthest_of
    wrench = np.array([MASS, MASS, INERTIA]) * furthest_of
    assert np.array(rows(poses)).T @ forces == pytest.approx(wrench, abs=1e-7)
    if name not in ("doubled", "row"):  # in a facet's plane with more than two wheels they only share by load
        least = one.shared(tuple(furthest_of), friction)
        at_slip = bool(np.dot(cone.limit, furthest_of) > 0.999999)
        assert max(np.abs(forces) / (friction * np.array(one.loads(*furthest_of[:2])) + 1e-9)) <= 1.0 + 1e-6
        if at_slip:
            assert forces == pytest.approx(least.forces, abs=1e-6 * friction * WEIGHT)
        loads = friction * np.array(one.loads(*(size * furthest_of[:2])))
        assert np.all(size * np.abs(forces) <= loads + 1e-6)


@pytest.mark.parametrize("name", ["omni4", "asymmetric", "plus", "three", "eccentric"])
@settings(max_examples=60, deadline=None)
@given(direction=directions, force=st.floats(8.0, 80.0), friction=st.sampled_from([0.3, 0.8]))
def test_where_motors_give_less_than_the_floor_both_limit(
    name: str, direction: Three, force: float, friction: float
) -> None:
    """At the limit no wheel is asked for more than either gives, and no forces would do more (weak duality)."""
    poses, inertia = LAYOUTS[name], 0.5
    matrix = np.array(rows(poses))
    places = [(x, y) for x, y, _ in poses]
    pushes = [Push(force, inertia)] * len(poses)
    one = Grip(rows(poses), places, mass=MASS, inertia=INERTIA, height=0.08, pushes=pushes)
    cone = max(one.cones(friction), key=lambda cone: float(np.dot(cone.limit, direction)))
    factor = 1.0 / max(float(np.dot(cone.limit, direction)), part_of(one.lifting(), direction))
    reached = np.array(direction) * factor
    forces, wrench = np.array(cone.forces) @ reached, np.array([MASS, MASS, INERTIA]) * reached
    assert matrix.T @ forces == pytest.approx(wrench, abs=1e-7)
    loads, gained = np.array(one.loads(*reached[:2])), matrix @ reached
    assert np.all(np.abs(forces) <= friction * loads + 1e-6)
    assert np.all(np.abs(forces + inertia * gained) <= force + 1e-6)
    if np.dot(cone.limit, reached) > 0.999999:
        best = inf
        for a, b in combinations(matrix, 2):
            normal = np.cross(a, b)
            if np.linalg.norm(normal) > 1e-9:
                normal *= np.sign(normal @ wrench) or 1.0
                sides = np.sign(np.round(matrix @ normal, 9))
                most = np.minimum(friction * loads, force - inertia * sides * gained)
                best = min(best, float(most @ np.abs(matrix @ normal)) / max(abs(float(normal @ wrench)), 1e-12))
        assert best == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("friction", "direction", "torque", "acceleration"),
    [
        (0.3, 0.0, 1.20, 2.01),
        (0.6, 0.0, 1.98, 3.32),
        (0.9, 0.0, 2.53, 4.25),
        (0.3, pi / 2, 1.32, 1.35),
        (0.6, pi / 2, 2.45, 2.51),
        (0.9, pi / 2, 3.42, 3.50),
        (0.3, pi / 4, 1.41, 1.26),
        (0.6, pi / 4, 2.73, 2.44),
        (0.9, pi / 4, 3.95, 3.53),
    ],
)
def test_loads_explain_the_first_slip_measured_in_mujoco(
    friction: float, direction: float, torque: float, acceleration: float
) -> None:
    """Forces of least norm, which are equal torques along an axis: by bisection, until the first wheel slips."""
    one, matrix, radius = grip(OMNI4), np.array(rows(OMNI4)), RADIUS
    along = np.array([cos(direction), sin(direction), 0.0])
    forces = np.linalg.pinv(matrix.T) @ (MASS * along)
    low, high = 0.0, 8.0
    for _ in range(60):
        size = 0.5 * (low + high)
        loads = one.loads(size * along[0], size * along[1])
        grips = all(size * abs(force) <= friction * load for force, load in zip(forces, loads, strict=True))
        low, high = (size, high) if grips else (low, size)
    torques = low * (radius * np.abs(forces) + ROTOR / radius * np.abs(matrix @ along))
    assert low == pytest.approx(acceleration, rel=0.012)
    assert max(torques) == pytest.approx(torque, rel=0.012)


@pytest.mark.parametrize(
    ("friction", "direction", "most", "given_away"),
    [
        (0.3, 0.0, 2.549, 0.206),
        (0.6, 0.0, 5.097, 0.342),
        (0.9, 0.0, 7.646, 0.438),
        (0.6, pi / 2, 2.943, 0.148),
        (0.9, pi / 2, 4.415, 0.206),
    ],
)
def test_equal_torques_give_away_up_to_four_tenths(
    friction: float, direction: float, most: float, given_away: float
) -> None:
    """All four at their limit: mu g cos(30 deg) forward, mu g / 2 to the left (MuJoCo's 2.549 and 5.097)."""
    along = (cos(direction), sin(direction), 0.0)
    one, matrix = grip(OMNI4), np.array(rows(OMNI4))
    best = 1.0 / part_of(limits(one, friction), along)
    assert best == pytest.approx(most, abs=6e-4)
    forces = np.abs(np.linalg.pinv(matrix.T) @ (MASS * np.array(along)))
    slips = min(
        friction * load / (force - friction * (change @ along[:2]))
        for force, load, change in zip(forces, one.resting, np.array(one.shifts), strict=True)
        if force > friction * (change @ along[:2])
    )
    assert 1.0 - slips / best == pytest.approx(given_away, abs=2e-3)


def test_loads_balance_and_none_is_negative() -> None:
    one = grip(OMNI4)
    assert one.loads(0.0, 0.0) == pytest.approx([WEIGHT / 4.0] * 4)
    assert one.loads(3.32, 0.0) == pytest.approx([40.6, 82.1, 82.1, 40.6], abs=0.1)  # MuJoCo: 40 and 82 N
    for ax, ay in ((6.0, 9.0), (0.0, 16.0), (9.0, 0.5), (-5.0, -10.0)):
        loads = one.loads(ax, ay)
        assert min(loads) >= 0.0
        if 0.0 in loads and sum(load > 0.0 for load in loads) >= 3:
            assert sum(loads) == pytest.approx(WEIGHT)
            assert sum(n * x for n, (x, _, _) in zip(loads, OMNI4, strict=True)) == pytest.approx(-2.5 * ax)


def test_beyond_tipping_over_two_wheels_carry_everything() -> None:
    assert grip(OMNI4, height=1.0).loads(9.0, 0.0) == pytest.approx([0.0, WEIGHT / 2, WEIGHT / 2, 0.0])


def test_a_centre_outside_the_wheels_is_refused() -> None:
    with pytest.raises(GripError, match=r"wheel 1 carries -.* N at rest"):
        grip([(x + 0.3, y, a) for x, y, a in OMNI4])


def test_room_is_what_a_curve_leaves() -> None:
    given = limits(grip(OMNI4, height=0.0), 0.6)
    assert room(given, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)) == pytest.approx(5.097, abs=1e-3)
    left = room(given, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    assert part_of(given, (left, 1.0, 0.0)) == pytest.approx(1.0)
    assert room(given, (0.0, 4.0, 0.0), (1.0, 0.0, 0.0)) == 0.0, "the curve alone is too much"
    assert room(given, (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)) == inf
