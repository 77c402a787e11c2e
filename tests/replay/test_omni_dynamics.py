"""The plant of omni wheels with all its inertia: the figures of science and of MuJoCo, energy, slip and loads.

Figures of MuJoCo: measured with version 4.0 on omni4, its centre of mass 0.10 m high.
"""

from itertools import pairwise
from math import cos, hypot, inf, pi, radians, sin
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.chassis.omni import OmniRobot, WheelPose, omni_kinematics
from gateway.config import load
from replay.sim.plants import plant_of
from replay.sim.plants.contract import PlantName
from replay.sim.plants.omni_dynamics import OmniDynamics, Stribeck
from replay.sim.plants.omni_equations import OmniEquations
from replay.sim.plants.omni_parameters import OmniParameters, WheelParameters, kane_robot, parameters

Array = NDArray[np.float64]
OMNI = Path(__file__).parents[2] / "deploy" / "robots" / "omni4.toml"
H = 1e-3  # s, a substep
INCH = 0.0254
WEIGHT = 25.0 * 9.81
COS30 = 0.8660254037844386
DIRECTIONS = {"forward": 0.0, "left": pi / 2.0, "45 degrees": pi / 4.0}


def robot(**body: float | None) -> OmniRobot:
    found = load(OMNI)[0].robot
    assert isinstance(found, OmniRobot)
    return found.model_copy(update={"body": found.body.model_copy(update=body)})


def started(*, friction: float = inf, height: float | None = 0.10, **body: float) -> OmniDynamics:
    """omni4 without friction in its joints, on this floor."""
    free: dict[str, float | None] = {"joint_friction": 0.0, "joint_drag": 0.0, "centre_height": height}
    plant = OmniDynamics(parameters(robot(**(free | body))))
    return on_floor(plant, friction)


def on_floor(plant: OmniDynamics, friction: float) -> OmniDynamics:
    for wheel in plant.wheels:
        plant.set_friction(wheel, friction)
    return plant


def run(plant: OmniDynamics, seconds: float, torques: tuple[float, ...] = ()) -> list[float]:
    """The energy before and after each substep."""
    energies = [plant.energy]
    for _ in range(round(seconds / H)):
        plant.step(torques or (0.0,) * len(plant.wheels))
        energies.append(plant.energy)
    return energies


def accelerating(direction: float) -> tuple[Array, float]:
    """Torques of omni4 of least norm, the largest of 1 N m, and the m/s^2 they give along this direction.

    By hand: a wheel of radius 0.0762 m with its axle at 60 degrees (and mirrored) rolls with -sin, cos of it.
    """
    axles = np.radians([60.0, 120.0, 240.0, 300.0])
    rolling = np.array([-np.sin(axles), np.cos(axles)]).T / 0.0762
    mass = 25.0 * np.eye(2) + 0.004 * rolling.T @ rolling
    torques = np.linalg.pinv(rolling.T) @ mass @ np.array((cos(direction), sin(direction)))
    largest = float(np.abs(torques).max())
    return torques / largest, 1.0 / largest


def measured(plant: OmniDynamics, direction: float, torque: float, seconds: float = 0.2) -> tuple[float, float]:
    """m/s^2 along the direction under least-norm torques, the largest so many N m, after 0.1 s; largest slip, m/s."""
    torques = tuple(map(float, torque * accelerating(direction)[0]))
    run(plant, 0.1, torques)
    before = plant.twist
    run(plant, seconds, torques)
    gained = plant.twist.vx - before.vx, plant.twist.vy - before.vy
    return (gained[0] * cos(direction) + gained[1] * sin(direction)) / seconds, max(map(abs, slips(plant)))


def slips(plant: OmniDynamics) -> list[float]:
    """m/s of each rim over the floor."""
    held = robot().kinematics().wheel_speeds(plant.twist)
    return [0.0762 * (rate - other) for rate, other in zip(plant.rates, held, strict=True)]


def swung(step: int) -> tuple[float, float, float, float]:
    """Torques of a drive that turns everything."""
    return 3.0 * cos(step / 300.0), 2.5 * sin(step / 200.0), 2.0 * cos(step / 100.0), -1.5 * sin(step / 250.0)


# -- the robot of the paper: K1 to K4 of science 6 --------------------------------------------------------------------


def test_a_straight_track_with_a_spin_k1() -> None:
    """q' = (10, 10, 5): along the diagonal while it spins, the wheels as the rows say at each heading."""
    plant = OmniDynamics(kane_robot())
    robot, start = OmniEquations(kane_robot()), (10.0 * INCH, 10.0 * INCH)
    for heading in np.linspace(0.0, 2.0 * pi, 13):
        c, s = cos(heading), sin(heading)
        body = (c * start[0] + s * start[1], c * start[1] - s * start[0], 5.0)
        plant.set_velocity(body)
        assert plant.rates == pytest.approx(robot.joint_rates(body))
        v1, v2 = body[0] / INCH, body[1] / INCH
        assert plant.rates == pytest.approx([(v1 - 40) / 3, (v1 + 40) / 3, (v2 - 40) / 3, (v2 + 40) / 3], rel=1e-9)
        estimate = kinematics(kane_robot()).twist(plant.rates)
        assert estimate is not None
        vx, vy, wz = estimate.twist
        assert (c * vx - s * vy, s * vx + c * vy, wz) == pytest.approx((*start, 5.0))


def test_a_spin_about_itself_k2() -> None:
    """(10, -10, 10, -10) rad/s: -3.75 rad/s at 8 in, no translation, 10.715 lbf in; the floor keeps it there."""
    plant = OmniDynamics(kane_robot())
    estimate = kinematics(kane_robot()).twist((10.0, -10.0, 10.0, -10.0))
    assert estimate is not None
    assert estimate.twist == pytest.approx((0.0, 0.0, -3.75), abs=1e-12)
    plant.set_velocity((0.0, 0.0, -3.75))
    assert plant.rates == pytest.approx((10.0, -10.0, 10.0, -10.0))
    assert plant.energy / 0.1129848 == pytest.approx(10.715, abs=5e-4)
    run(plant, 1.0)
    assert plant.pose == pytest.approx((0.0, 0.0, -3.75), abs=1e-9)


def test_wheels_that_contradict_each_other_k3() -> None:
    """(10, -8, 6, -4) rad/s: w1 - w2 - w3 + w4 = 8 rad/s, a quarter of it on each wheel."""
    estimate = kinematics(kane_robot()).twist((10.0, -8.0, 6.0, -4.0))
    assert estimate is not None
    assert estimate.residuals is not None
    parts = np.array(estimate.residuals, np.float64) / (3.0 * INCH)
    assert parts == pytest.approx([2.0, -2.0, -2.0, 2.0])
    assert parts @ (1.0, -1.0, -1.0, 1.0) == pytest.approx(8.0)


def test_energy_is_kept_for_50_s_k4() -> None:
    """In a motion that turns and bends, in the paper's robot and in omni4: to 1e-6."""
    for plant, motion in ((OmniDynamics(kane_robot()), (0.6, -0.4, 3.0)), (started(), (1.5, -1.0, 4.0))):
        plant.set_velocity(motion)
        energies = run(plant, 0.5)
        assert abs(plant.twist.vx - motion[0]) > 0.3, "it does bend"
        energies += run(plant, 49.5)
        assert max(energies) / min(energies) == pytest.approx(1.0, abs=1e-6)


def test_a_free_spin_bends_the_path() -> None:
    """Added mass has no Coriolis term: the velocity turns at w (1 - M / M_eff) in the world (science 4)."""
    plant = OmniDynamics(kane_robot())
    plant.set_velocity((0.5, 0.0, 2.0))
    run(plant, 0.2)
    c, s = cos(plant.pose.theta), sin(plant.pose.theta)
    vx, vy, _ = plant.twist
    turned = np.arctan2(s * vx + c * vy, c * vx - s * vy)
    assert plant.pose.theta == pytest.approx(0.4, rel=1e-6)
    assert turned == pytest.approx(0.4 * (1.0 - 0.25498 / 0.3040), rel=0.01)


def kinematics(of: OmniParameters):  # type: ignore[no-untyped-def]  # noqa: ANN201
    return omni_kinematics([WheelPose(wheel.x, wheel.y, wheel.axis_angle, wheel.radius) for wheel in of.wheels])


# -- energy and momentum ----------------------------------------------------------------------------------------------


def test_energy_is_what_the_torques_give() -> None:
    plant, work = started(), 0.0
    for step in range(3000):
        angles, torques = plant.angles, swung(step)
        plant.step(torques)
        work += sum(torque * (new - old) for torque, new, old in zip(torques, plant.angles, angles, strict=True))
    assert plant.energy > 5.0
    assert plant.energy == pytest.approx(work, rel=1e-4)


@pytest.mark.parametrize("friction", [0.0, 0.02, 0.1, 0.4])
@pytest.mark.parametrize("inertia", [1e-4, 0.004, 0.05])
def test_no_energy_is_made_on_slippery_ground(friction: float, inertia: float) -> None:
    """At most what the motors give, and none from nothing. (Bounds twice what was measured.)"""
    plant, work = started(friction=friction, joint_inertia=inertia), 0.0
    for step in range(3000):
        torques = tuple(2.0 * torque for torque in swung(step))
        angles = plant.angles
        plant.step(torques)
        work += sum(torque * (new - old) for torque, new, old in zip(torques, plant.angles, angles, strict=True))
        assert plant.energy <= work + 2e-5 * max(1.0, plant.energy)
    energies = run(plant, 2.0)
    assert all(after <= before * (1.0 + 5e-6) for before, after in pairwise(energies))
    assert energies[-1] <= energies[0] * (1.0 + 1e-5)


@pytest.mark.parametrize(("inertia", "drag", "viscous"), [(1e-5, 0.0, 0.18), (1e-3, 1.3, 0.18), (0.05, 50.0, 0.0)])
def test_friction_only_slows_a_loose_wheel_however_light_it_is(inertia: float, drag: float, viscous: float) -> None:
    plant = started(friction=0.0, joint_inertia=inertia, joint_drag=drag, joint_friction=viscous)
    run(plant, 0.005, (9.0, -9.0, 9.0, 9.0))
    energies = run(plant, 0.5)
    assert energies[0] > 1e-6
    assert all(after <= before for before, after in pairwise(energies))


def test_ground_that_is_not_exhausted_is_as_ground_that_holds() -> None:
    held, free = started(), started(friction=5.0)
    for step in range(1000):
        held.step(swung(step))
        free.step(swung(step))
        assert free.slipping == ()
    assert free.pose == pytest.approx(held.pose, abs=2e-5)
    assert free.angles == pytest.approx(held.angles, abs=2e-4)
    on_floor(free, inf)
    assert free.velocity == pytest.approx(held.velocity, abs=1e-5)


# -- loads ------------------------------------------------------------------------------------------------------------


def test_at_rest_every_wheel_of_omni4_carries_a_quarter_also_on_a_slope_it_does_not_drive_on() -> None:
    plant = started()
    assert plant.loads == pytest.approx([WEIGHT / 4.0] * 4)
    plant.set_mass(50.0)
    assert plant.loads == pytest.approx([WEIGHT / 2.0] * 4)


def test_a_push_at_the_centre_of_mass_shifts_no_load_and_the_floor_does() -> None:
    pushed, driven = started(), started()
    pushed.push = 50.0
    run(pushed, 0.1)
    wheels = 4.0 * 0.004 * (COS30 / 0.0762) ** 2  # kg: what they take of the push goes through the floor
    held_back = 50.0 * wheels / (25.0 + wheels)
    assert pushed.loads[0] - pushed.loads[1] == pytest.approx(0.10 * held_back / 0.20, rel=0.02)
    run(driven, 0.1, tuple(map(float, 1.5 * accelerating(0.0)[0])))
    front, rear = driven.loads[0] + driven.loads[3], driven.loads[1] + driven.loads[2]
    assert front + rear == pytest.approx(WEIGHT)
    force = 25.0 * 1.5 * accelerating(0.0)[1]
    assert rear - front == pytest.approx(0.10 * force / 0.10, rel=1e-3)


def test_a_robot_that_coasts_and_spins_shifts_no_load() -> None:
    """Its velocity turns in its own axes and hardly in the world: the floor gives what the wheels ask for."""
    plant = started()
    plant.set_velocity((1.5, 0.0, 4.0))
    for _ in range(500):
        run(plant, H)
        assert plant.loads == pytest.approx([WEIGHT / 4.0] * 4, abs=4.0)
    assert plant.pose.theta > 1.9


def test_a_push_keeps_its_direction_while_the_robot_spins() -> None:
    """50 N for 0.5 s on 25 kg whose wheels weigh nothing: 1 m/s along world x, and none across."""
    free = parameters(robot(joint_inertia=0.0, joint_friction=0.0, joint_drag=0.0))
    wheels = tuple(wheel._replace(roller_inertia=0.0) for wheel in free.wheels)
    plant = OmniDynamics(free._replace(wheels=wheels))
    plant.set_velocity((0.0, 0.0, 4.0))
    plant.push = 50.0
    run(plant, 0.5)
    c, s = cos(plant.pose.theta), sin(plant.pose.theta)
    vx, vy, _ = plant.twist
    assert (c * vx - s * vy, s * vx + c * vy) == pytest.approx((1.0, 0.0), abs=1e-5)


def test_on_a_slope_that_the_motors_hold_the_lower_wheels_carry_more() -> None:
    """Weight along the slope at the centre, the floor's force below it: the moment is height times that force."""
    plant = started(friction=0.8)
    plant.slope = radians(10.0)
    force = WEIGHT * sin(plant.slope)
    torque = force / (4.0 * COS30) * 0.0762
    run(plant, 0.1, (-torque, -torque, torque, torque))
    assert plant.twist.vx == pytest.approx(0.0, abs=1e-3)
    front, rear = plant.loads[0] + plant.loads[3], plant.loads[1] + plant.loads[2]
    assert front + rear == pytest.approx(WEIGHT * cos(plant.slope))
    assert rear - front == pytest.approx(force, rel=1e-2)


def test_where_the_height_is_not_known_no_load_is_shifted() -> None:
    plant = started(height=None)
    run(plant, 0.2, tuple(map(float, 2.0 * accelerating(0.0)[0])))
    assert plant.loads == pytest.approx([WEIGHT / 4.0] * 4)


def test_a_wheel_that_lifts_gives_nothing() -> None:
    """A robot three times as high: at 3.3 m/s^2, which its rear wheels give, its front wheels hang in the air."""
    plant = started(friction=5.0, height=0.30)
    run(plant, 0.2, tuple(map(float, 8.0 / accelerating(0.0)[1] * accelerating(0.0)[0])))
    assert plant.loads[0] == pytest.approx(0.0, abs=1e-6)
    assert 0 in plant.slipping
    assert 3 in plant.slipping
    assert plant.loads[1] + plant.loads[2] == pytest.approx(WEIGHT)


# -- slip: the figures of MuJoCo and of the theory ---------------------------------------------------------------------

FIRST_SLIP = [
    (0.3, "forward", 1.20, 2.01),
    (0.3, "left", 1.32, 1.35),
    (0.3, "45 degrees", 1.41, 1.26),
    (0.6, "forward", 1.98, 3.32),
    (0.6, "left", 2.45, 2.51),
    (0.6, "45 degrees", 2.73, 2.44),
    (0.9, "forward", 2.53, 4.25),
    (0.9, "left", 3.42, 3.50),
    (0.9, "45 degrees", 3.95, 3.53),
]


@pytest.mark.parametrize(("friction", "name", "torque", "acceleration"), FIRST_SLIP)
def test_the_torque_at_which_the_first_wheel_slips(
    friction: float, name: str, torque: float, acceleration: float
) -> None:
    """Within 3 % of the table: below it nothing slips, above it something does."""
    direction = DIRECTIONS[name]
    low, high = 0.9 * torque, 1.1 * torque
    while high - low > 1e-3:
        middle = (low + high) / 2.0
        _, slip = measured(started(friction=friction), direction, middle)
        low, high = (middle, high) if slip < 1e-3 else (low, middle)
    assert low == pytest.approx(torque, rel=0.03)
    reached, _ = measured(started(friction=friction), direction, low)
    assert reached == pytest.approx(acceleration, rel=0.03)


@pytest.mark.parametrize("friction", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("name", DIRECTIONS)
def test_at_95_per_cent_of_it_nothing_slips_and_the_acceleration_is_that_of_the_torques(
    friction: float, name: str
) -> None:
    torque = next(row[2] for row in FIRST_SLIP if row[:2] == (friction, name))
    direction = DIRECTIONS[name]
    reached, slip = measured(started(friction=friction), direction, 0.95 * torque)
    assert slip <= 1e-3
    assert reached == pytest.approx(0.95 * torque * accelerating(direction)[1], rel=1e-3)


@pytest.mark.parametrize(("friction", "expected"), [(0.3, 2.549), (0.6, 5.097)])
def test_with_every_wheel_slipping_the_floor_gives_mu_g_cos_30(friction: float, expected: float) -> None:
    plant = started(friction=friction)
    reached, slip = measured(plant, 0.0, 9.0)
    assert reached == pytest.approx(expected, rel=1e-3)
    assert slip > 1.0
    assert plant.slipping == (0, 1, 2, 3)


def test_a_tenth_above_the_limit_only_the_front_pair_slips() -> None:
    """mu 0.6, forward; at first slip the front wheels carry 40 N and the rear ones 82 N."""
    plant = started(friction=0.6)
    measured(plant, 0.0, 1.1 * 1.98)
    assert plant.slipping == (0, 3)
    limit = started(friction=0.6)
    measured(limit, 0.0, 1.98)
    assert limit.loads == pytest.approx((40.0, 82.0, 82.0, 40.0), abs=1.0)


def test_without_weight_transfer_all_four_slip_together() -> None:
    plant = started(friction=0.6, height=None)
    measured(plant, 0.0, 1.1 * 3.0)
    assert plant.slipping == (0, 1, 2, 3)


def test_one_motor_without_torque_gives_half_the_acceleration_when_the_others_share_anew() -> None:
    """Front left dead, driven by the rear pair; without sharing anew it veers and yaws as it does in MuJoCo."""
    whole, shared, veering = (started() for _ in range(3))
    full = (-1.0, -1.0, 1.0, 1.0)
    run(whole, 0.2, full)
    run(shared, 0.2, (0.0, -1.0, 1.0, 0.0))
    assert shared.twist.vx == pytest.approx(whole.twist.vx / 2.0, rel=1e-9)
    assert (shared.twist.vy, shared.twist.wz) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert shared.rates == pytest.approx(robot().kinematics().wheel_speeds(shared.twist), abs=1e-9)
    run(veering, 0.01, (0.0, *full[1:]))
    vx, vy, wz = veering.twist
    assert abs(vy / vx) == pytest.approx(0.26 / 1.26, rel=0.05)
    assert abs(wz / vx) == pytest.approx(2.6 / 1.26, rel=0.05)


def test_the_residual_is_nearly_blind_in_a_diagonal_launch() -> None:
    """At 45 degrees two opposite wheels slip alike: several m/s of slip, and a hundredth of it to be seen."""
    plant = started(friction=0.3)
    measured(plant, pi / 4.0, 4.0, seconds=0.4)
    slip = slips(plant)
    assert min(abs(slip[0]), abs(slip[2])) > 1.0 or min(abs(slip[1]), abs(slip[3])) > 1.0
    assert abs(slip[0] - slip[1] + slip[2] - slip[3]) < 0.1 * max(map(abs, slip))


def test_one_oily_wheel_slips_alone() -> None:
    plant = started()
    plant.set_friction(2, 0.1)
    run(plant, 0.3, tuple(map(float, 1.5 * accelerating(0.0)[0])))
    assert plant.slipping == (2,)
    assert abs(slips(plant)[2]) > 0.3


def test_friction_that_drops_with_slip() -> None:
    """Wheelspin then costs acceleration: all slipping fast, what is left of mu is its kinetic share."""
    plant = started(friction=0.6)
    plant.stribeck = Stribeck(kinetic=0.7, speed=0.1)
    reached, _ = measured(plant, 0.0, 9.0)
    assert reached == pytest.approx(0.7 * 5.097, abs=2e-3)
    gripping = started(friction=0.6)
    gripping.stribeck = Stribeck(kinetic=0.7, speed=0.1)
    held, slip = measured(gripping, 0.0, 0.97 * 1.98)
    assert slip <= 1e-3
    assert held == pytest.approx(0.97 * 1.98 * accelerating(0.0)[1], rel=1e-3)


def test_how_friction_drops_with_slip() -> None:
    """The body held still by its mass, one heavy wheel that slips at twice the Stribeck speed: e^-4 is left."""
    plant = started(friction=0.4, mass=5000.0, inertia=5000.0, joint_inertia=10.0, height=None)
    plant.stribeck = Stribeck(kinetic=0.5, speed=0.1)
    plant._spins[0] = 0.2 / 0.0762
    plant._tell_rates()
    before = plant.rates[0]
    plant.step((0.0,) * 4)
    torque = 0.4 * (0.5 + 0.5 * 0.01831564) * 5000.0 * 9.81 / 4.0 * 0.0762
    assert before - plant.rates[0] == pytest.approx(H * torque / 10.0, rel=1e-6)


def test_the_loads_of_a_high_robot_do_not_chatter() -> None:
    """What slipping front wheels give less loads them more: at 0.30 m and mu 0.9 by 1.17 times as much."""
    plant = started(friction=0.9, height=0.30)
    run(plant, 0.1, tuple(map(float, 2.0 * accelerating(0.0)[0])))
    assert plant.slipping == (0, 3)
    for _ in range(20):
        before = plant.loads
        run(plant, H, tuple(map(float, 2.0 * accelerating(0.0)[0])))
        assert plant.loads == pytest.approx(before, abs=0.05)


# -- joints, robot file -----------------------------------------------------------------------------------------------


def test_dry_and_viscous_friction_of_the_joints_hold_gripping_and_slipping_wheels_alike() -> None:
    """The same torque, so much of it lost: in the equilibrium of a wheel off the ground, and of the robot on it."""
    for friction in (0.0, inf):
        plant = started(friction=friction, joint_friction=0.05, joint_drag=0.2)
        run(plant, 30.0, (0.7, 0.7, 0.7, 0.7))
        assert plant.rates == pytest.approx([(0.7 - 0.2) / 0.05] * 4, rel=1e-3)


def test_what_the_robot_file_says_and_what_it_leaves_open() -> None:
    """A roller of rubber, 2/15 of 76.2 mm in radius and three radii long: 15 g, of which half is felt across."""
    found = parameters(robot())
    assert (found.mass, found.inertia, found.centre_height) == (25.0, 0.9, 0.10)
    assert (found.friction, found.drag) == (0.02, 0.09)
    assert [wheel.spin_inertia for wheel in found.wheels] == [0.004] * 4
    wheel = found.wheels[0]
    assert wheel.roller_inertia / wheel.roller_radius**2 == pytest.approx(
        1522.0 * pi * 0.01016**2 * 0.03048 / 2.0, rel=1e-3
    )
    own = robot().wheel[0].model_copy(update={"roller_mass": 0.5})
    heavy = parameters(robot().model_copy(update={"wheel": [own, *robot().wheel[1:]]})).wheels[0]
    assert heavy.roller_inertia / heavy.roller_radius**2 == pytest.approx(0.25)


def test_rollers_add_inertia_across_the_wheel_alone() -> None:
    """One wheel with its axle along x: its roller is felt along x and not along y."""

    def mass(inertia: float) -> tuple[float, float]:
        wheels = [
            WheelParameters(x, y, 0.0, 0.1, spin_inertia=0.0, roller_radius=0.01, roller_inertia=inertia)
            for x, y in ((0.2, 0.0), (0.0, 0.2), (-0.2, -0.2))
        ]
        robot = OmniEquations(OmniParameters(10.0, 1.0, tuple(wheels)))
        return robot.resistance_to((1.0, 0.0, 0.0))[0], robot.resistance_to((0.0, 1.0, 0.0))[1]

    assert mass(0.0) == pytest.approx((10.0, 10.0))
    assert mass(1e-5) == pytest.approx((10.0 + 3 * 0.1, 10.0))


def test_wheels_in_one_line_are_refused_with_the_reason() -> None:
    own = robot()
    line = [wheel.model_copy(update={"x": 0.1 * place, "y": 0.0}) for place, wheel in enumerate(own.wheel)]
    with pytest.raises(ValueError, match=r"plant = 'dynamics': all wheels stand in one line"):
        plant_of(own.model_copy(update={"wheel": line}), PlantName.DYNAMICS)


def test_three_wheels_and_six_drive_slip_and_stop() -> None:
    for count in (3, 6):
        wheels = tuple(
            WheelParameters(0.2 * cos(angle), 0.2 * sin(angle), angle, 0.05, 0.002, 0.007, 1e-6)
            for angle in (2.0 * pi * place / count + 0.3 for place in range(count))
        )
        plant = on_floor(OmniDynamics(OmniParameters(12.0, 0.3, wheels, centre_height=0.08)), 0.4)
        for step in range(1500):
            plant.step([1.5 * cos(step / 200.0 + 2.0 * place) for place in range(count)])
            assert sum(plant.loads) == pytest.approx(12.0 * 9.81)
        assert hypot(plant.pose.x, plant.pose.y) > 0.01
