"""Every chassis: straight, strafe, rotate, combined, round trip, wheel order, sign; numbers derived beside."""

from collections.abc import Sequence
from math import cos, hypot, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.config import load
from gateway.kinematics.contract import GeometryError, Kinematics, desaturate
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.offset_differential import CasterGeometry, OffsetDifferentialKinematics
from gateway.types import Twist

ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
speeds = st.floats(-5.0, 5.0)
angles = st.floats(-10.0, 10.0)


def kinematics(name: str) -> Kinematics:
    robot = load(ROBOTS / f"{name}.toml")[0].robot
    return robot.kinematics()


def ring(*degrees: float, distance: float = 0.3, radius: float = 0.05) -> FixedWheels:
    poses = [
        WheelPose(distance * cos(a), distance * sin(a), a, radius) for a in (degree * pi / 180.0 for degree in degrees)
    ]
    return omni_kinematics(poses)


# Four wheels at 45, 135, 225, 315 degrees, 0.3 m out, radius 0.05 m: drive directions are the axles turned by 90
# degrees, so forward (1 m/s) is -sin(45) = -0.7071 m/s of rim at 45 and 135 degrees and +0.7071 at 225 and 315;
# left is cos; a turn of 1 rad/s is 0.3 m/s of rim everywhere. Divided by 0.05 m: 14.142 and 6 rad/s.
Q = sqrt(0.5) / 0.05
X_DRIVE = [
    (Twist(1, 0, 0), [-Q, -Q, Q, Q]),
    (Twist(0, 1, 0), [Q, -Q, -Q, Q]),
    (Twist(0, 0, 1), [6.0, 6.0, 6.0, 6.0]),
    (Twist(1, 1, 1), [6.0, 6.0 - 2 * Q, 6.0, 6.0 + 2 * Q]),
]

# Otbot-1: R 0.1, d1 0.25, d2 0.4. Platform along the chassis: forward 1 m/s is 10 rad/s of both wheels; left 1 m/s
# turns the chassis at 1/0.25 = 4 rad/s, so the wheels at -+4*0.2/0.1 = -+8 rad/s, the joint against it at -4; a turn
# of the platform is the joint's alone. Platform a quarter turn left of the chassis: what is forward to the platform
# is left to the chassis.
OTBOT = [
    (0.0, Twist(1, 0, 0), [10.0, 10.0, 0.0]),
    (0.0, Twist(0, 1, 0), [-8.0, 8.0, -4.0]),
    (0.0, Twist(0, 0, 1), [0.0, 0.0, 1.0]),
    (pi / 2, Twist(1, 0, 0), [-8.0, 8.0, -4.0]),
    (pi / 2, Twist(0, 1, 0), [-10.0, -10.0, 0.0]),
    (pi, Twist(1, 0, 0), [-10.0, -10.0, 0.0]),
    (0.0, Twist(1, 1, 1), [2.0, 18.0, -3.0]),
]


@pytest.mark.parametrize(("twist", "expected"), X_DRIVE)
def test_omni_by_hand(twist: Twist, expected: list[float]) -> None:
    assert ring(45, 135, 225, 315).wheel_speeds(twist) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("phi", "twist", "expected"), OTBOT)
def test_offset_by_hand(phi: float, twist: Twist, expected: list[float]) -> None:
    assert kinematics("moby").wheel_speeds(twist, [0.0, 0.0, phi]) == pytest.approx(expected, abs=1e-12)


@given(speeds, speeds, speeds, angles)
@pytest.mark.parametrize("name", ["moby", "omni4", "mecanum4"])
def test_round_trip(name: str, vx: float, vy: float, wz: float, phi: float) -> None:
    chassis = kinematics(name)
    positions = [0.0, 0.0, phi, 0.0]
    wheels = chassis.wheel_speeds(Twist(vx, vy, wz), positions)
    assert wheels is not None
    estimate = chassis.twist(wheels, positions)
    assert estimate is not None
    assert estimate.twist == pytest.approx((vx, vy, wz), abs=1e-12)
    assert estimate.residual is None or estimate.residual == pytest.approx(0.0, abs=1e-12)
    for lost in range(len(wheels)):
        some = [None if place == lost else wheel for place, wheel in enumerate(wheels)]
        found = chassis.twist(some, positions)
        assert chassis.motion(some, positions) == (None if found is None else found.twist)
    assert chassis.motion(wheels, positions) == estimate.twist


@given(st.lists(angles, min_size=4, max_size=4), st.floats(0.3, 3.0))
def test_omni_rows_are_the_velocity_of_the_contact_point(contact: list[float], radius: float) -> None:
    """Independent derivation: differentiate the contact point of a turning body numerically."""
    x, y, axis, theta = contact
    step = 1e-6
    wheels = [WheelPose(x, y, axis, radius), *[WheelPose(cos(a), sin(a), a, 1.0) for a in (0.0, 2.0, 4.0)]]
    moved = np.array([cos(step) * x - sin(step) * y, sin(step) * x + cos(step) * y])
    drive = np.array([cos(axis + pi / 2), sin(axis + pi / 2)])
    turning = float(drive @ (moved - [x, y])) / step / radius
    row = [omni_kinematics(wheels).wheel_speeds(twist)[0] for twist in (Twist(1, 0, 0), Twist(0, 1, 0), Twist(0, 0, 1))]
    assert row == pytest.approx([drive[0] / radius, drive[1] / radius, turning], abs=1e-4 + 1e-5 * abs(theta))


LAYOUTS = [
    (45, 135, 225, 315),
    (30, 150, 210, 330),
    (30, 150, 225, 315),
    (0, 120, 240),
    (10, 100, 200, 250, 300),
    (0, 60, 120, 180, 240, 300),
    (33, 147, 225, 315),
    (5, 175, 185, 355),
]


@pytest.mark.parametrize("degrees", LAYOUTS)
def test_pseudo_inverse_is_an_inverse(degrees: Sequence[float]) -> None:
    chassis = ring(*degrees)
    rows, inverse = np.array(chassis.rim_matrix), np.array(chassis.rim_pinv)
    assert inverse @ rows == pytest.approx(np.eye(3), abs=1e-14)
    assert inverse == pytest.approx(np.linalg.pinv(rows), abs=1e-13)


def test_printed_inverse_of_the_paper_fails() -> None:
    """Erratum E-001-7/8: the printed rows 2 and 3 for the asymmetric layout (front 33, rear 45 degrees) are wrong."""
    phi, theta = 33 * pi / 180, 45 * pi / 180
    i, k = 1 / (2 * sin(phi) + 2 * sin(theta)), sin(theta) / (2 * sin(phi) + 2 * sin(theta))
    j = cos(phi) / (2 * cos(phi) ** 2 + 2 * cos(theta) ** 2)
    printed = np.array([[-i, -i, i, i], [j, -j, -(1 - j), 1 - j], [k, k, 1 - k, 1 - k]])
    d = np.array([[-sin(a), cos(a), 1.0] for a in (phi, pi - phi, pi + theta, -theta)])
    assert not np.allclose(printed @ d, np.eye(3), atol=1e-3)


@pytest.mark.parametrize("degrees", [(0, 180), (0, 0, 180), (10, 190, 10, 190), (20, 20, 20)])
def test_fewer_than_three_directions_are_refused(degrees: Sequence[float]) -> None:
    with pytest.raises(GeometryError):
        ring(*degrees)


def test_slip_of_one_wheel_is_seen_but_not_located() -> None:
    """Rojas R4: 0.1 m/s of one wheel of four leaves a residual of half of it, whichever wheel it is."""
    chassis = ring(30, 150, 210, 330)
    for wheel in range(4):
        wheels = chassis.wheel_speeds(Twist(0.5, -0.2, 1.0))
        wheels[wheel] += 0.1 / 0.05
        estimate = chassis.twist(wheels)
        assert estimate is not None
        assert estimate.residual == pytest.approx(0.05)


@given(st.lists(st.floats(-50.0, 50.0), min_size=6, max_size=6), st.data())
@pytest.mark.parametrize("degrees", LAYOUTS)
def test_residual_of_each_wheel_is_what_no_motion_explains(
    degrees: Sequence[float], wheels: list[float], data: st.DataObject
) -> None:
    """(I - D D+) m by numpy's least squares, of wheels of which any may be silent and each has a radius of its own."""
    radii = [0.05 + 0.01 * place for place in range(len(degrees))]
    poses = [WheelPose(0.3, 0.1, degree * pi / 180.0, radius) for degree, radius in zip(degrees, radii, strict=True)]
    poses = [pose._replace(x=0.3 * cos(pose.axis_angle), y=0.2 * sin(pose.axis_angle)) for pose in poses]
    speeds: list[float | None] = list(wheels[: len(degrees)])
    for silent in data.draw(st.sets(st.integers(0, len(degrees) - 1), max_size=2)):
        speeds[silent] = None
    heard = [place for place, speed in enumerate(speeds) if speed is not None]
    estimate = omni_kinematics(poses).twist(speeds)
    if len(heard) <= 3:
        assert estimate is None or (estimate.residual, estimate.residuals) == (None, None)
        return
    rows = np.array([rim_row(poses[place]) for place in heard])
    rims = np.array([speeds[place] for place in heard], np.float64) * [radii[place] for place in heard]
    unexplained = rims - rows @ np.linalg.lstsq(rows, rims)[0]
    assert estimate is not None
    assert estimate.residuals is not None
    assert [estimate.residuals[place] for place in heard] == pytest.approx(unexplained, abs=1e-12)
    assert [place for place, residual in enumerate(estimate.residuals) if residual is not None] == heard
    assert estimate.residual == pytest.approx(np.linalg.norm(unexplained), abs=1e-12)


def rim_row(pose: WheelPose) -> list[float]:
    """Rim speed per m/s forward, m/s left and rad/s: the direction of rolling, and its moment about the centre."""
    forward, left = cos(pose.axis_angle + pi / 2), sin(pose.axis_angle + pi / 2)
    return [forward, left, pose.x * left - pose.y * forward]


def test_the_wheel_that_slips_alone_among_many_stands_out() -> None:
    """Six wheels, one 0.1 m/s too fast: no other is as far off. Of four all are off alike: nothing is located."""
    for degrees, located in (((0, 60, 120, 180, 240, 300), True), ((30, 150, 210, 330), False)):
        chassis = ring(*degrees)
        wheels = chassis.wheel_speeds(Twist(0.5, -0.2, 1.0))
        wheels[1] += 0.1 / 0.05
        estimate = chassis.twist(wheels)
        assert estimate is not None
        assert estimate.residuals is not None
        sizes = [abs(residual or 0.0) for residual in estimate.residuals]
        assert (sorted(sizes)[-2] < 0.9 * sizes[1]) is located
        assert max(sizes) == pytest.approx(0.05 if located else 0.025)


def test_odometry_survives_any_single_encoder() -> None:
    chassis = kinematics("omni4")
    twist = Twist(0.4, -0.3, 0.8)
    complete = chassis.wheel_speeds(twist, [])
    assert complete is not None
    for lost in range(4):
        wheels = [None if index == lost else speed for index, speed in enumerate(complete)]
        estimate = chassis.twist(wheels, [])
        assert estimate is not None
        assert estimate.twist == pytest.approx(twist)
        assert (estimate.residual, estimate.residuals) == (None, None)
        assert chassis.reach([speed is not None for speed in wheels]).complete
    assert chassis.twist([None, None, 1.0, 1.0], []) is None
    assert not chassis.reach([False, False, True, True]).complete


def test_offset_needs_every_motor_and_its_joint_angle() -> None:
    chassis = kinematics("moby")
    assert chassis.twist([1.0, None, 0.0], [0.0, 0.0, 0.0]) is None
    assert chassis.twist([1.0, 1.0, 0.0], [0.0, 0.0, None]) is None
    assert chassis.wheel_speeds(Twist(1, 0, 0), [0.0, 0.0, None]) is None
    assert not chassis.reach([True, True, False]).complete
    with pytest.raises(GeometryError):
        OffsetDifferentialKinematics(wheel_radius=0.1, axle_offset=1e-4, track=0.4)


def test_caster_settles_behind() -> None:
    """Acceptance M10: pushing leads beta to -90 degrees, pulling to +90; the printed sign does neither."""
    chassis = OffsetDifferentialKinematics(
        wheel_radius=0.1, axle_offset=0.25, track=0.4, caster=CasterGeometry(0.05, 0.25, 0.05)
    )
    for speed, settled in ((0.5, -pi / 2), (-0.5, pi / 2)):
        beta = settled + 1.0
        for _ in range(2000):
            beta += 1e-3 * chassis.caster_rates(Twist(speed, 0, 0), phi=0.0, beta=beta).swivel
        assert beta == pytest.approx(settled, abs=1e-3)


@given(st.lists(st.floats(-100, 100), min_size=1, max_size=6), st.floats(0.1, 10))
def test_desaturate_keeps_direction(wheels: list[float], limit: float) -> None:
    factor = desaturate(wheels, [limit] * len(wheels))
    assert 0.0 < factor <= 1.0
    assert max(abs(speed) * factor for speed in wheels) <= limit * (1 + 1e-12)
    assert factor == 1.0 or max(abs(speed) * factor for speed in wheels) == pytest.approx(limit)


def test_wheel_top_speed_bounds_the_robot() -> None:
    """Otbot at full speed in any direction: sqrt(12^2 + 9.6^2) = 15.4 rad/s at most, within its 22 rad/s."""
    chassis = kinematics("moby")
    worst = 0.0
    for step in range(360):
        wheels = chassis.wheel_speeds(Twist(1.2, 0, 0), [0.0, 0.0, step * pi / 180])
        assert wheels is not None
        worst = max(worst, abs(wheels[0]))
    assert worst == pytest.approx(hypot(12.0, 9.6), rel=1e-3)
