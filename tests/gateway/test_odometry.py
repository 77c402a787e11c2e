"""Odometry: exact arcs, no drift at rest, honest covariance, jumps told apart from motion."""

from collections.abc import Sequence
from math import cos, pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.contract import Sideways
from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.core.odometry import WheelOdometry, advance
from gateway.types import Displacement, Growth, Pose, Twist

RADIUS = 0.05
POSES = [WheelPose(0.3 * cos(a), 0.3 * sin(a), a, RADIUS) for a in (pi / 4, 3 * pi / 4, 5 * pi / 4, 7 * pi / 4)]
STEP_NS = 4_000_000


def take(
    odometry: WheelOdometry,
    positions: Sequence[float | None],
    step: int,
    *,
    residual: float = 0.0,
    heading: float | None = None,
    age_ns: int = 0,
) -> list[int]:
    """One cycle; the joints that jumped. `age_ns`: of all positions."""
    deltas, jumped = odometry.deltas(positions, [age_ns] * len(positions), step * STEP_NS)
    odometry.update(deltas, positions, residual=residual, dt=0.004, heading=heading)
    return jumped


def drive(odometry: WheelOdometry, twist: Twist, steps: int, *, residual: float = 0.0, start: int = 0) -> None:
    """Wheel positions of a constant twist, sampled every 4 ms."""
    rates = omni_kinematics(POSES).wheel_speeds(twist)
    for step in range(start, start + steps + 1):
        take(odometry, [rate * (step - start) * 0.004 for rate in rates], step, residual=residual)


def omni() -> WheelOdometry:
    return WheelOdometry(omni_kinematics(POSES), top_speeds=[200.0] * 4)


def test_straight_strafe_and_turn() -> None:
    for twist in (Twist(1, 0, 0), Twist(0, 1, 0), Twist(0, 0, 1)):
        odometry = omni()
        drive(odometry, twist, 250)
        assert odometry.pose == pytest.approx(twist, abs=1e-9)


def test_a_circle_closes_exactly() -> None:
    """1 m/s forward at pi rad/s for 2 s: a circle of radius 1/pi, back at the start whatever the step."""
    odometry = omni()
    drive(odometry, Twist(1.0, 0.0, pi), 500)
    assert odometry.pose == pytest.approx((0.0, 0.0, 2 * pi), abs=1e-9)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3), st.integers(1, 50))
def test_one_step_equals_many(vx: float, vy: float, wz: float, parts: int) -> None:
    """The exponential map of a constant twist does not depend on how it is cut."""
    whole = advance(Pose(1.0, 2.0, 0.5), Displacement(vx, vy, wz))
    pose = Pose(1.0, 2.0, 0.5)
    for _ in range(parts):
        pose = advance(pose, Displacement(vx / parts, vy / parts, wz / parts))
    assert pose == pytest.approx(whole, abs=1e-9)


def test_covariance_grows_with_the_way_and_not_at_rest() -> None:
    odometry = omni()
    drive(odometry, Twist(1, 0, 0), 250)
    near = odometry.read(None, None).covariance
    assert odometry.read(None, None).covariance == near
    drive(odometry, Twist(1, 0, 0), 250, start=251)
    far = odometry.read(None, None).covariance
    assert 0 < near[0] < far[0]
    assert 0 < near[8] < far[8]
    assert far[4] > far[0], "across the way the heading error adds up"
    assert far[1] == far[3]


@given(
    st.lists(
        st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3), st.floats(0.0, 0.5), st.integers(0, 100)),
        max_size=12,
    ),
    st.sampled_from([None, 0.0, 0.7]),
)
def test_the_covariance_is_positive_definite_always(
    drives: list[tuple[float, float, float, float, int]], gyro: float | None
) -> None:
    """From the first cycle on: whoever fuses the odometry inverts it."""
    odometry, positions, now_ns = omni(), [0.0] * 4, 0
    for vx, vy, wz, residual, steps in drives:
        rates = omni_kinematics(POSES).wheel_speeds(Twist(vx, vy, wz))
        for _ in range(steps):
            now_ns += STEP_NS
            positions = [position + rate * 0.004 for position, rate in zip(positions, rates, strict=True)]
            heading = None if gyro is None else gyro * now_ns * 1e-9
            take(odometry, positions, now_ns // STEP_NS, residual=residual, heading=heading)
        covariance = np.array(odometry.read(None, None).covariance).reshape(3, 3)
        assert (covariance == covariance.T).all()
        assert np.linalg.eigvalsh(covariance)[0] > 0.0
    first = np.array(omni().read(None, None).covariance).reshape(3, 3)
    assert np.linalg.eigvalsh(first)[0] > 0.0


def test_the_covariance_is_positive_definite_after_a_long_way() -> None:
    """10 km straight on: the heading error's lever is at its longest."""
    odometry = omni()
    rate = omni_kinematics(POSES).wheel_speeds(Twist(1, 0, 0))
    for step in range(10_000):
        take(odometry, [one * step for one in rate], 250 * step)
        if step % 50 == 0:
            odometry.read(None, None)
    covariance = np.array(odometry.read(None, None).covariance).reshape(3, 3)
    assert odometry.pose.x > 9000.0
    assert np.linalg.eigvalsh(covariance)[0] > 0.0


def test_covariance_grows_with_what_the_wheels_cannot_explain() -> None:
    clean, slipping = omni(), omni()
    drive(clean, Twist(1, 0, 0), 250, residual=0.0)
    drive(slipping, Twist(1, 0, 0), 250, residual=0.1)
    grip, slip = (odometry.read(None, None).covariance for odometry in (clean, slipping))
    assert slip[0] == pytest.approx(grip[0] + 0.01, rel=0.01), "0.1 m/s of slip for 1 s: 0.1 m standard deviation"
    assert slip[8] > grip[8]


def test_a_counter_that_restarts_is_no_motion() -> None:
    odometry = omni()
    drive(odometry, Twist(1, 0, 0), 250)
    before = odometry.pose
    jumped = take(odometry, [0.0, 0.0, 0.0, 0.0], 251)
    assert jumped == [0, 1, 2, 3]
    assert odometry.pose == before
    assert take(odometry, [0.01, 0.01, -0.01, -0.01], 252) == []


def test_a_late_frame_costs_nothing() -> None:
    odometry = omni()
    rates = omni_kinematics(POSES).wheel_speeds(Twist(1, 0, 0))
    for step in (0, 1, 2, 20, 21):
        take(odometry, [rate * step * 0.004 for rate in rates], step)
    assert odometry.pose.x == pytest.approx(0.084)


def test_a_joint_that_is_measured_at_rest_jumps_all_the_same() -> None:
    """200 rad/s of top speed are 0.8 rad in 4 ms, allowed twice; for how long the joint stood before says nothing."""
    odometry = omni()
    for step in range(50):
        take(odometry, [1.0] * 4, step)
    assert take(odometry, [1.0, 2.5, 2.7, 1.0], 50) == [2]


def test_the_way_of_a_joint_that_was_silent_is_left_out() -> None:
    """However short: its controller may have counted from zero again, near by."""
    odometry = omni()
    take(odometry, [1.0] * 4, 0)
    take(odometry, [None] * 4, 1)
    assert take(odometry, [1.2, 1.2, 0.8, 0.8], 2) == []
    assert odometry.pose == Pose(0.0, 0.0, 0.0)
    take(odometry, [1.3, 1.3, 0.7, 0.7], 3)
    assert odometry.pose != Pose(0.0, 0.0, 0.0), "from then on it counts"


def test_what_was_not_measured_meanwhile_may_have_turned_as_long() -> None:
    """The same position without a new measurement is no standing joint: 0.4 s at 200 rad/s are 80 rad, twice 160."""
    odometry = omni()
    take(odometry, [1.0] * 4, 0)
    for step in range(1, 100):
        take(odometry, [1.0] * 4, step, age_ns=step * STEP_NS)
    assert take(odometry, [1.0, 160.0, 162.0, 1.0], 100) == [2]


def test_unknown_positions_are_not_zero() -> None:
    odometry = omni()
    take(odometry, [None] * 4, 0)
    drive(odometry, Twist(1, 0, 0), 10)
    take(odometry, [None] * 4, 11)
    assert odometry.pose.x == pytest.approx(0.04)


# the heading of a gyro


def drive_with_gyro(
    odometry: WheelOdometry, twist: Twist, headings: Sequence[float | None], *, residual: float = 0.0
) -> None:
    """The wheels tell this twist from cycle to cycle; the gyro tells these headings."""
    rates = omni_kinematics(POSES).wheel_speeds(twist)
    for step, heading in enumerate(headings):
        slip = residual if step else 0.0
        take(odometry, [rate * step * 0.004 for rate in rates], step, residual=slip, heading=heading)


def test_the_turn_is_the_gyros_and_the_way_is_the_wheels() -> None:
    """The wheels say straight on, 1 m; the gyro says a quarter of a circle: an arc of radius 2/pi m."""
    odometry = omni()
    drive_with_gyro(odometry, Twist(1, 0, 0), [5.0 + pi / 2 * step / 250 for step in range(251)])
    assert odometry.pose == pytest.approx((2 / pi, 2 / pi, pi / 2), abs=1e-9)


def test_a_gyro_that_agrees_changes_nothing() -> None:
    plain, with_gyro = omni(), omni()
    drive(plain, Twist(0.3, -0.2, 2.0), 250)
    drive_with_gyro(with_gyro, Twist(0.3, -0.2, 2.0), [2.0 * step * 0.004 for step in range(251)])
    assert with_gyro.pose == pytest.approx(plain.pose, abs=1e-9)


def test_the_covariance_grows_as_the_robot_file_says() -> None:
    """Each growth by itself: a metre forward, and a radian turned, in 250 cycles."""
    growth = Growth(position=0.01, heading_turning=0.03, heading_driving=0.02)
    told = []
    for twist in (Twist(1.0, 0.0, 0.0), Twist(0.0, 0.0, 1.0)):
        odometry = WheelOdometry(omni_kinematics(POSES), top_speeds=[200.0] * 4, growth=growth)
        drive(odometry, twist, 250)
        covariance = odometry.read(None, None).covariance
        told.append([covariance[place] - 1e-6 for place in (0, 8)])
    assert told[0] == pytest.approx([0.01, 0.02])
    assert told[1] == pytest.approx([0.0, 0.03], abs=1e-9)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_heading_that_wraps_is_no_turn_back(direction: float) -> None:
    """From 170 degrees on by 20 degrees is -170 degrees, in one cycle."""
    odometry = omni()
    drive_with_gyro(odometry, Twist(0, 0, 0), [direction * 170 * pi / 180, -direction * 170 * pi / 180])
    assert odometry.pose == pytest.approx((0.0, 0.0, direction * 20 * pi / 180), abs=1e-12)


def test_a_gyro_that_was_silent_may_have_begun_anew() -> None:
    """Meanwhile the wheels tell the turn, 4 mrad per cycle; the gyro's first heading afterwards is a reference."""
    odometry = omni()
    drive_with_gyro(odometry, Twist(0, 0, 1), [1.0, 1.1, None, None, -2.0, -1.9])
    assert odometry.pose.theta == pytest.approx(0.1 + 3 * 0.004 + 0.1)


def test_a_gyro_turns_the_pose_where_the_wheels_tell_nothing() -> None:
    for positions in ([0.0] * 4, [None] * 4):
        odometry = omni()
        take(odometry, positions, 0, heading=0.0)
        take(odometry, positions, 1, heading=0.2)
        assert odometry.pose == (0.0, 0.0, 0.2)


def heading_deviation(odometry: WheelOdometry) -> float:
    """Standard deviation beyond the one that every pose begins with, rad."""
    return sqrt(odometry.read(None, None).covariance[8] - 1e-6)


def test_the_heading_of_a_gyro_wanders_with_time_and_errs_with_the_turn() -> None:
    """0.001 rad after a second whatever the wheels do, 0.0077 after a minute, 1 % of the first radian turned."""
    for seconds, twist, expected in ((1, Twist(1, 0, 0), 1e-3), (60, Twist(0, 0, 0), 60**0.5 * 1e-3)):
        odometry = omni()
        drive_with_gyro(odometry, twist, [0.0] * (250 * seconds + 1), residual=0.1)
        assert heading_deviation(odometry) == pytest.approx(expected, rel=1e-6)
    odometry = omni()
    drive_with_gyro(odometry, Twist(0, 0, 1), [step * 0.004 for step in range(251)])
    assert heading_deviation(odometry) == pytest.approx((1e-4 + 1e-6) ** 0.5, rel=1e-6)


def test_a_gyro_leaves_the_place_as_doubtful_as_the_wheels_are() -> None:
    """1 m driven at 0.1 m/s of slip: 0.02 m of the way and 0.1 m of the slip, with a gyro or without."""
    for headings in ([None] * 251, [0.0] * 251):
        odometry = omni()
        drive_with_gyro(odometry, Twist(1, 0, 0), headings, residual=0.1)
        assert odometry.read(None, None).covariance[0] == pytest.approx(4e-4 + 0.01, rel=0.01)
    assert heading_deviation(odometry) < 0.0011


def slid(theta: float, *, heading: bool) -> np.ndarray:
    """Covariance of a robot that stands at this heading and slips for a second, in excess of that of the start."""
    odometry = omni()
    take(odometry, [0.0] * 4, 0)
    odometry.pose = Pose(0.0, 0.0, theta)
    x, y, t = 0.1, -0.2, 0.5  # m/s, m/s, rad/s that it may err by, together
    spread = (x * x, x * y, x * t, y * y, y * t, t * t)
    for step in range(1, 251):
        odometry.deltas([0.0] * 4, [0] * 4, step * STEP_NS)
        angle = 0.0 if heading else None
        odometry.update([0.0] * 4, [0.0] * 4, residual=9.0, dt=0.004, heading=angle, spread=spread)
    return np.array(odometry.read(None, None).covariance).reshape(3, 3) - 1e-6 * np.eye(3)


@given(st.floats(-3.0, 3.0))
def test_slip_makes_the_pose_uncertain_along_the_twist_by_which_it_puts_it_wrong(theta: float) -> None:
    """0.1, -0.2 m/s and 0.5 rad/s for a second, in the frame of the world; along no other direction at all."""
    c, s = cos(theta), sin(theta)
    along = np.array([0.1 * c + 0.2 * s, 0.1 * s - 0.2 * c, 0.5])
    assert slid(theta, heading=False) == pytest.approx(np.outer(along, along), abs=1e-12)


def test_a_gyro_keeps_the_heading_out_of_it() -> None:
    found = slid(0.0, heading=True)
    assert found[:2, :2] == pytest.approx(np.array([[0.01, -0.02], [-0.02, 0.04]]), abs=1e-12)
    assert found[2, :2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert found[2, 2] <= 2e-3 + 0.25 * 0.004, "the gyro's own second; its first sample said nothing of the turn"


# a chassis that errs more one way than another

LIKELY = Sideways(position=1.5, heading=4.0)


def uneven(way: Displacement, *, beside: float = 0.0, heading: float | None = None) -> list[float]:
    """Variances of x, y and theta that 1 s of this motion of omni4 adds, where a way to the side errs more."""
    odometry = WheelOdometry(omni_kinematics(POSES), top_speeds=[200.0] * 4, sideways=LIKELY)
    deltas = omni_kinematics(POSES).wheel_speeds(Twist(*way))
    odometry.update(deltas, (), residual=None, dt=1.0, heading=heading, beside=beside)
    if heading is not None:
        odometry.update(deltas, (), residual=None, dt=1.0, heading=heading, beside=beside)
    covariance = odometry.read(None, None).covariance
    return [covariance[place] - 1e-6 for place in (0, 4, 8)]


def test_a_way_to_the_side_errs_more_than_one_forward() -> None:
    """Of 0.5 m: 4e-4 m^2/m and 1e-4 rad^2/m forward; and what the heading's error adds across the way, at rest none."""
    forward, left = uneven(Displacement(0.5, 0.0, 0.0)), uneven(Displacement(0.0, 0.5, 0.0))
    assert forward == pytest.approx([2e-4, 2e-4, 0.5e-4], abs=1e-6)
    assert left == pytest.approx([3e-4, 3e-4, 2e-4], abs=1e-6)


def test_a_way_of_another_axis_errs_as_one_to_the_side() -> None:
    still, gyro = Displacement(0.0, 0.0, 0.0), 0.3
    assert uneven(still, beside=0.5) == pytest.approx([3e-4, 3e-4, 2e-4], abs=1e-9)
    assert uneven(still, beside=-0.5) == uneven(still, beside=0.5)
    assert uneven(still) == [0.0, 0.0, 0.0]
    x, y, theta = uneven(still, beside=0.5, heading=gyro)
    assert (x, y) == pytest.approx((6e-4, 6e-4), abs=1e-9)
    assert theta == pytest.approx(1e-6), "the gyro's own, of the second in which it told a turn"
