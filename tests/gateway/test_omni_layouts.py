"""n omni wheels in any layout: check, kinematics, coupling of forces, and a drive of each through the core."""

from collections.abc import Sequence
from itertools import combinations, product
from math import cos, pi, sin

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.config import ConfigError, parse
from gateway.core.examination import examine
from gateway.kinematics.contract import GeometryError
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.forces import DIRECTIONS, PushTable, force_coupling, least_forces
from gateway.kinematics.linear import Matrix, kernel, pseudo_inverse
from gateway.types import Mode, Twist
from tests.omni_layouts import ARM, LAYOUTS, RADIUS, Wheel, text
from tests.world import World

every = pytest.mark.parametrize("layout", LAYOUTS)
of_four = pytest.mark.parametrize("layout", [name for name, wheels in LAYOUTS.items() if len(wheels) == 4])
MASS, INERTIA = 25.0, 0.9
BODY: Matrix = ((MASS, 0.0, 0.0), (0.0, MASS, 0.0), (0.0, 0.0, INERTIA))
ALL_OF_FOUR = (True,) * 4


def kinematics(layout: str) -> FixedWheels:
    found = parse(text(layout), layout).robot.kinematics()
    assert isinstance(found, FixedWheels)
    return found


def rim_rows(wheels: Sequence[Wheel]) -> npt.NDArray[np.float64]:
    """By the moment of a unit force: along the drive direction at the contact point."""
    forces = [(cos(angle + pi / 2), sin(angle + pi / 2)) for _, _, angle in wheels]
    return np.array([(fx, fy, x * fy - y * fx) for (fx, fy), (x, y, _) in zip(forces, wheels, strict=True)])


@every
def test_check_takes_it(layout: str) -> None:
    report = examine(parse(text(layout), layout), layout)
    assert (report.rank, report.motors) == (3, len(LAYOUTS[layout]))
    assert report.condition < 100.0


# Rim speeds by hand, m/s, for 1 m/s forward, 1 m/s to the left and 1 rad/s. Axles outward at a: -sin a, cos a, 0.2.
H, Q = 3**0.5 / 2, 0.5**0.5
RIMS = {
    "symmetric": ([-H, -H, H, H], [0.5, -0.5, -0.5, 0.5], [0.2] * 4),
    "diagonal": ([-Q, -Q, Q, Q], [Q, -Q, -Q, Q], [0.2] * 4),
    "narrow": ([-0.98769, -0.98769, 0.98769, 0.98769], [0.15643, -0.15643, -0.15643, 0.15643], [0.2] * 4),
    "asymmetric": ([-0.83867, -Q, Q, 0.83867], [0.54464, -Q, -Q, 0.54464], [0.2] * 4),
    "plus": ([1, 1, 0, 0], [0, 0, 1, 1], [-0.2, 0.2, -0.2, 0.2]),
    "three": ([-H, 0, H], [0.5, -1, 0.5], [0.2] * 3),
    "five": ([-0.58779, -0.95106, 0, 0.95106, 0.58779], [0.80902, -0.30902, -1, -0.30902, 0.80902], [0.2] * 5),
    "six": ([-0.5, -1, -0.5, 0.5, 1, 0.5], [H, 0, -H, -H, 0, H], [0.2] * 6),
}


@pytest.mark.parametrize("layout", RIMS)
def test_straight_strafe_rotate_and_combined_by_hand(layout: str) -> None:
    chassis, by_axis = kinematics(layout), RIMS[layout]
    for twist in (Twist(1, 0, 0), Twist(0, 1, 0), Twist(0, 0, 1), Twist(0.5, -0.3, 2.0)):
        rims = [sum(part * rim for part, rim in zip(twist, rims, strict=True)) for rims in zip(*by_axis, strict=True)]
        assert chassis.wheel_speeds(twist) == pytest.approx([rim / RADIUS for rim in rims], abs=1e-4)


@every
def test_rows_are_moments_and_the_inverse_is_one(layout: str) -> None:
    """R1, to 1e-12; and the round trip, the kernel and the projection (R5)."""
    chassis, rows = kinematics(layout), rim_rows(LAYOUTS[layout])
    inverse = np.array(chassis.rim_pinv)
    assert np.array(chassis.rim_matrix) == pytest.approx(rows, abs=1e-15)
    assert np.abs(inverse @ rows - np.eye(3)).max() <= 1e-12
    projection = rows @ inverse
    assert np.abs(projection @ projection - projection).max() <= 1e-12, "R5: idempotent"
    assert np.abs(inverse @ projection - inverse).max() <= 1e-12, "R5: the motion that is told stays the same"
    unexplained = np.array(kernel(tuple(map(tuple, rows.T))))
    assert len(unexplained) == len(rows) - 3
    if len(unexplained):
        assert np.abs(unexplained @ rows).max() <= 1e-12


@of_four
def test_pushes_of_one_axis_and_rigid_motions_do_not_slip(layout: str) -> None:
    """R4: of any D v nothing is left; of one wheel that is 0.1 m/s faster, what of it the kernel sees."""
    chassis = kinematics(layout)
    for twist in (Twist(1, 0, 0), Twist(0, 1, 0), Twist(0, 0, 1), Twist(1.2, -0.7, 3.0)):
        speeds = chassis.wheel_speeds(twist)
        estimate = chassis.twist(speeds)
        assert estimate is not None
        assert estimate.residual == pytest.approx(0.0, abs=1e-12)
        (seen,) = kernel(tuple(map(tuple, np.array(chassis.rim_matrix).T)))
        for wheel, share in enumerate(seen):
            faster = [speed + (0.1 / RADIUS if place == wheel else 0.0) for place, speed in enumerate(speeds)]
            estimate = chassis.twist(faster)
            assert estimate is not None
            assert estimate.residual == pytest.approx(0.1 * abs(share), abs=1e-12)
            if layout in ("symmetric", "diagonal", "narrow", "plus"):
                assert estimate.residual == pytest.approx(0.05, abs=1e-12)


def test_the_printed_inverse_of_the_asymmetric_layout_fails_and_the_right_one_holds() -> None:
    """R2, in the frame of the paper: x right, y forward. E-001-7 and 8: rows 2 and 3 of the print are wrong."""
    phi, theta = 33 * pi / 180, 45 * pi / 180
    i, k = 1 / (2 * sin(phi) + 2 * sin(theta)), sin(theta) / (2 * sin(phi) + 2 * sin(theta))
    over = 2 * cos(phi) ** 2 + 2 * cos(theta) ** 2
    j, rear = cos(phi) / over, cos(theta) / over
    printed = np.array([[-i, -i, i, i], [j, -j, -(1 - j), 1 - j], [k, k, 1 - k, 1 - k]])
    right = np.array([[-i, -i, i, i], [j, -j, -rear, rear], [k, k, 0.5 - k, 0.5 - k]])
    # Of the robot file the wheels are front left, rear left, rear right, front right; of the paper front right first.
    order = [3, 0, 1, 2]
    rows = np.array(kinematics("asymmetric").rim_matrix)[order] @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1 / ARM]]).T
    ours = np.array([[0, -1, 0], [1, 0, 0], [0, 0, ARM]]) @ np.array(kinematics("asymmetric").rim_pinv)[:, order]
    assert ours == pytest.approx(right, abs=1e-12)
    assert np.abs(ours @ rows - np.eye(3)).max() <= 1e-12
    assert np.abs(printed @ rows - np.eye(3)).max() > 0.5


@every
def test_coupling_of_forces_is_newtons_law(layout: str) -> None:
    """M a = D' f; C C+ = I; C and D' have one kernel (science 2); what is added from it moves nothing."""
    rows = rim_rows(LAYOUTS[layout])
    coupling = force_coupling(kinematics(layout).rim_matrix, BODY)
    assert np.array(coupling) == pytest.approx(np.linalg.solve(np.array(BODY), rows.T), abs=1e-13)
    assert np.array(coupling) @ np.array(pseudo_inverse(coupling)) == pytest.approx(np.eye(3), abs=1e-12)
    assert np.array(pseudo_inverse(coupling)) == pytest.approx(np.linalg.pinv(np.array(coupling)), abs=1e-10)
    for free in kernel(coupling):
        assert np.abs(rows.T @ np.array(free)).max() <= 1e-12


@of_four
@pytest.mark.parametrize("dead", range(4))
def test_without_one_motor_any_acceleration_is_still_exactly_so(layout: str, dead: int) -> None:
    """R7: f of the dead one is zero, the others give the commanded acceleration to 1e-12."""
    usable = [place != dead for place in range(4)]
    rows = kinematics(layout).rim_matrix
    coupling = force_coupling(rows, BODY)
    for wanted in ((1.5, 0.0, 0.0), (0.0, -0.8, 0.0), (0.4, 0.3, 5.0)):
        forces = least_forces(coupling, wanted, usable)
        assert forces is not None
        assert forces[dead] == 0.0
        assert np.array(coupling) @ np.array(forces) == pytest.approx(np.array(wanted), abs=1e-12)


@pytest.mark.parametrize("layout", ["symmetric", "diagonal", "narrow"])
@pytest.mark.parametrize("dead", range(4))
def test_without_one_motor_the_peak_forward_acceleration_is_exactly_half(layout: str, dead: int) -> None:
    """R7; and so it is sideways."""
    table = PushTable(kinematics(layout).rim_matrix, (1.0,) * 4)
    usable = [place != dead for place in range(4)]
    for direction in (0.0, pi / 2):
        assert table.along(direction, usable) == pytest.approx(0.5 * table.along(direction, ALL_OF_FOUR), abs=1e-12)


@of_four
@pytest.mark.parametrize("dead", list(combinations(range(4), 2)))
def test_with_two_motors_dead_it_is_no_omni_robot_any_more(layout: str, dead: tuple[int, ...]) -> None:
    """R7: refused, by the reach and by the forces."""
    chassis = kinematics(layout)
    usable = [place not in dead for place in range(4)]
    reach = chassis.reach(usable)
    assert (reach.rank, reach.complete, reach.effort) == (2, False, 0.0)
    coupling = force_coupling(chassis.rim_matrix, BODY)
    assert any(least_forces(coupling, unit, usable) is None for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert least_forces(coupling, (1, 0, 0), [False] * 4) is None


@pytest.mark.parametrize("degrees", [(0, 180, 0, 180), (30, 30, 210, 210), (45, 45, 45, 45)])
def test_fewer_than_three_directions_are_refused_with_words(degrees: Sequence[float]) -> None:
    """R8, through the robot file."""
    base, chosen = text("symmetric"), iter(degrees)
    lines = [
        f"axis_angle = {next(chosen) * pi / 180}" if line.startswith("axis_angle") else line
        for line in base.splitlines()
    ]
    spread = [line if not line.startswith(("x = ", "y = ")) else f"{line[:4]}0.0" for line in lines]
    with pytest.raises(ConfigError, match=r"r\.toml: robot: wheel directions are not independent"):
        examine(parse("\n".join(spread), "r.toml"), "r.toml")


def best_by_vertices(rows: npt.NDArray[np.float64], direction: float) -> float:
    """max s with rows' f = s (cos, sin, 0) and |f| <= 1: at an optimum all but three of the f are at their limits."""
    size, best = len(rows), 0.0
    goal = np.array([cos(direction), sin(direction), 0.0])
    for inner in combinations(range(size), 2):
        outer = [place for place in range(size) if place not in inner]
        matrix = np.column_stack([*rows[list(inner)], -goal])
        if abs(np.linalg.det(matrix)) < 1e-9:
            continue
        for signs in product((1.0, -1.0), repeat=len(outer)):
            *forces, reached = np.linalg.solve(matrix, -rows[outer].T @ np.array(signs))
            if max(map(abs, forces)) <= 1.0 + 1e-9:
                best = max(best, reached)
    return best


@every
def test_effective_motors_are_the_best_of_a_linear_program(layout: str) -> None:
    """By enumerating the vertices of the program, in 25 directions, of all motors and of all but each one."""
    rows = rim_rows(LAYOUTS[layout])
    table = PushTable(kinematics(layout).rim_matrix, (2.0,) * len(rows))
    assert table.unit == pytest.approx(2.0)
    for dead in (None, *range(len(rows) if len(rows) > 3 else 0)):
        usable = [place != dead for place in range(len(rows))]
        kept = rows[usable]
        found = [table.along(direction, usable) for direction in np.linspace(0.0, pi, 25)]
        assert found == pytest.approx([best_by_vertices(kept, one) for one in np.linspace(0.0, pi, 25)], abs=1e-9)
        least = table.least(usable)
        assert 0.0 <= least.direction < pi
        assert least.motors <= min(found) + 1e-9
        assert table.along(least.direction, usable) == pytest.approx(least.motors, abs=1e-9)


def test_effective_motors_of_the_paper() -> None:
    """R3: 30 degrees: forward 3.464, sideways 2.0, diagonal 1.793, least 1.732 at 30 degrees from sideways."""
    table = PushTable(kinematics("symmetric").rim_matrix, (1.0,) * 4)
    found = [table.along(direction, ALL_OF_FOUR) for direction in (0.0, pi / 2, pi / 4)]
    assert found == pytest.approx([3.4641016, 2.0, 1.7931509], abs=1e-7)
    assert table.least(ALL_OF_FOUR) == pytest.approx((3**0.5, pi / 3), abs=1e-12)
    told = table.of((False, True, True, True))
    assert pytest.approx([step * pi / 12 for step in range(12)]) == DIRECTIONS
    assert [told.every[place] for place in (0, 6, 3)] == pytest.approx(found, abs=5e-4)
    # Without one: forward and sideways half; at 45 degrees it depends on which side the dead one is.
    assert [told.usable[place] for place in (0, 6)] == [1.732, 1.0]
    left = [table.along(direction, (False, True, True, True)) for direction in DIRECTIONS]
    assert told.usable == pytest.approx(left, abs=5e-4)


def test_what_is_left_of_the_push_without_two_motors_is_one_line() -> None:
    """Of the 45-degree robot the wheels at 45 and 225 degrees push along -45 degrees, 2 motors, and nowhere else."""
    table = PushTable(kinematics("diagonal").rim_matrix, (1.0,) * 4)
    usable = (True, False, True, False)
    assert [table.along(a, usable) for a in (0.0, pi / 4, pi / 2, 3 * pi / 4)] == pytest.approx([0, 0, 0, 2.0])
    assert table.least(usable) == (0.0, 0.0)
    assert table.of((False,) * 4).usable == (0.0,) * 12
    assert table.of((True, False, False, False)).usable == (0.0,) * 12, "one alone also turns it"


def test_a_weak_motor_counts_as_what_it_is() -> None:
    """One of half the torque, 45 degrees: forward all four pull alike, and the turn has to cancel: 4 x 0.5 x 0.7071."""
    table = PushTable(kinematics("diagonal").rim_matrix, (1.0, 0.5, 1.0, 1.0))
    assert table.along(0.0, ALL_OF_FOUR) == pytest.approx(best_by_vertices_of((1.0, 0.5, 1.0, 1.0)), abs=1e-9)


def best_by_vertices_of(strengths: Sequence[float]) -> float:
    """Forward, by scaling the rows: a force of u times a share of -1 to 1."""
    return best_by_vertices(rim_rows(LAYOUTS["diagonal"]) * np.array(strengths)[:, None], 0.0)


poses = st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.0, 6.28)), min_size=3, max_size=6)


@settings(max_examples=40, deadline=None)
@given(poses, st.floats(0.0, 3.14))
def test_effective_motors_of_any_layout(at: list[tuple[float, float, float]], direction: float) -> None:
    rows = rim_rows([Wheel(*one) for one in at])
    lever = np.abs(rows[:, 2]).max()
    if lever < 0.05 or np.linalg.cond(rows / [1.0, 1.0, lever]) > 1e3:
        return
    try:
        table = PushTable(tuple(map(tuple, rows)), (1.0,) * len(rows))
    except GeometryError:
        return
    found = table.along(direction, (True,) * len(rows))
    assert found == pytest.approx(best_by_vertices(rows, direction), rel=1e-6, abs=1e-6)


DRIVES = {
    "straight": Twist(0.6, 0.0, 0.0),
    "strafe": Twist(0.0, 0.5, 0.0),
    "rotate": Twist(0.0, 0.0, 1.5),
    "combined": Twist(0.4, -0.3, 0.6),
}


@every
@pytest.mark.parametrize("drive", DRIVES)
def test_drives_as_commanded(layout: str, drive: str) -> None:
    """Engine, CAN, simulated controllers and the simple plant: the true body moves so, and nothing slips.

    Of the narrow layout 0.156 m/s at the rims are 1 m/s sideways, so a wheel's error counts six times as much.
    """
    twist, slack = DRIVES[drive], 6.0 if layout == "narrow" else 1.0
    world = World("omni4", edit=lambda _: text(layout))
    world.start()
    world.run(1.5, twist)
    assert world.is_in(Mode.DRIVE)
    assert world.last.trace.setpoint == pytest.approx(twist, abs=1e-12)
    assert tuple(world.bus.robot.truth.twist) == pytest.approx(tuple(twist), abs=0.03 * slack)
    assert tuple(world.last.trace.measured or ()) == pytest.approx(tuple(twist), abs=0.03 * slack)
    assert (world.last.trace.residual or 0.0) < 0.02
    world.run(1.5)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.02 * slack
