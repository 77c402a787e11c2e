"""The simulated chassis: conservation of energy, steady states, closed-form paths, and the instability of pull."""

from itertools import pairwise
from math import atan2, cos, exp, pi, sin, tan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.chassis.omni import OmniRobot
from gateway.config import RobotConfig, load
from gateway.types import Twist
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import omni, plant_of
from replay.sim.plants.rigid_body import RigidBody, Vector

ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
NAMES = ("omni4", "moby")
Matrix = NDArray[np.float64]
SPEED = st.floats(-2.0, 2.0)
TORQUE = st.floats(-20.0, 20.0)


def config(name: str) -> RobotConfig:
    return load(ROBOTS / f"{name}.toml")[0]


def dynamics(name: str, *, friction: float = 0.0) -> RigidBody:
    return plant(name, joint_friction=friction)


def plant(name: str, **body: float) -> RigidBody:
    """The bundled robot without friction, with other figures of its body if asked."""
    robot = config(name).robot
    frictionless = {"joint_friction": 0.0, "joint_drag": 0.0}
    made = plant_of(robot.model_copy(update={"body": robot.body.model_copy(update=frictionless | body)}))
    assert isinstance(made, RigidBody)
    return made


def rows(model: RigidBody) -> Matrix:
    return np.array(model._chassis.rows)


def hold(model: RigidBody, friction: float) -> tuple[float, ...]:
    """Torques under which the present velocity does not change: they cancel gyroscopic forces and friction."""
    matrix, u = rows(model), np.array(model.velocity)
    wanted = matrix.T @ matrix @ u * friction - np.array(model._chassis.gyroscopic(model.velocity))
    return tuple(float(torque) for torque in np.linalg.pinv(matrix.T) @ wanted)


def run(model: RigidBody, seconds: float, torques: tuple[float, ...] | None = None) -> None:
    for _ in range(round(seconds / STEP_S)):
        model.step((0.0,) * len(model.angles) if torques is None else torques)


# -- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (0.5, -1.0, 2.0), (-1.2, 2.0, -1.0), (0.0, 4.0, 4.0)])
def test_energy_is_kept_without_torque_and_friction(name: str, velocity: Vector) -> None:
    model = dynamics(name)
    model.set_velocity(velocity)
    before = model.energy
    run(model, 3.0)
    assert model.energy == pytest.approx(before, rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_friction_only_takes_energy(name: str) -> None:
    model = dynamics(name, friction=0.5)
    model.set_velocity((0.5, -1.0, 2.0))
    energies = [model.energy]
    for _ in range(500):
        model.step((0.0,) * len(model.angles))
        energies.append(model.energy)
    assert all(later < earlier for earlier, later in pairwise(energies))


@pytest.mark.parametrize("name", NAMES)
def test_work_of_the_torques_becomes_energy(name: str) -> None:
    model = dynamics(name)
    model.set_velocity((0.3, 0.4, -0.7))
    torques = (1.0, -0.5, 2.0, 0.25)[: len(model.angles)]
    before, start = model.energy, np.array(model.angles)
    run(model, 0.5, torques)
    work = float(np.array(torques) @ (np.array(model.angles) - start))
    assert model.energy - before == pytest.approx(work, rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_joint_angles_are_the_integral_of_the_rates(name: str) -> None:
    model = dynamics(name)
    model.set_velocity((0.3, -0.2, 0.5))
    total = np.zeros(len(model.angles))
    for _ in range(200):
        before = np.array(model.rates)
        model.step((0.1,) * len(model.angles))
        total += (before + np.array(model.rates)) * STEP_S / 2.0
    assert np.allclose(model.angles, total, atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_two_runs_are_bit_equal(name: str) -> None:
    first, second = dynamics(name, friction=0.2), dynamics(name, friction=0.2)
    for model in (first, second):
        run(model, 0.3, (0.3, 0.7, -0.2, 0.1)[: len(model.angles)])
    assert (first.pose, first.angles, first.velocity) == (second.pose, second.angles, second.velocity)


# -- an independent derivation ----------------------------------------------------------------------------------------


def world_acceleration(robot: OffsetDifferentialRobot, u: Vector, heading: float, torques: Vector) -> Matrix:
    """du/dt by eliminating the constraints of the bodies in world coordinates (x, y, chassis, platform, left, right).

    q' = S(q) u, and S' (M S u' + M S' u) = S' Q with S' differentiated numerically; no body-frame formula is used.
    """
    spin = robot.body.joint_inertia
    mass = np.diag([robot.body.mass, robot.body.mass, robot.chassis_inertia, robot.body.inertia, spin, spin])
    mass[2:4, 2:4] += spin * np.array([[1.0, -1.0], [-1.0, 1.0]])  # rotor of the joint between chassis and platform

    def constraint(chassis: float) -> Matrix:
        c, s = cos(chassis), sin(chassis)
        radius, half = robot.wheel_radius, robot.track / 2.0
        return np.array(
            [
                [c, -robot.axle_offset * s, 0.0],
                [s, robot.axle_offset * c, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, 0.0, 1.0],
                [1.0 / radius, -half / radius, 0.0],
                [1.0 / radius, half / radius, 0.0],
            ]
        )

    step = 1e-6
    matrix = constraint(heading)
    rate = (constraint(heading + step * u[1]) - constraint(heading - step * u[1])) / (2.0 * step)
    left, right, platform = torques
    forces = np.array([0.0, 0.0, -platform, platform, left, right])
    return np.linalg.solve(matrix.T @ mass @ matrix, matrix.T @ (forces - mass @ rate @ np.array(u)))


@settings(max_examples=30, deadline=None)
@given(u=st.tuples(SPEED, SPEED, SPEED), heading=st.floats(-pi, pi), torques=st.tuples(TORQUE, TORQUE, TORQUE))
def test_offset_differential_agrees_with_world_coordinates(u: Vector, heading: float, torques: Vector) -> None:
    robot = config("moby").robot
    assert isinstance(robot, OffsetDifferentialRobot)
    model = dynamics("moby")
    drive = np.array(model._torque_rows) @ np.array(torques)
    ours = model._acceleration(u, tuple(drive))
    assert np.allclose(ours, world_acceleration(robot, u, heading, torques), atol=1e-6)


def test_omni_without_torque_keeps_its_course_when_the_wheels_weigh_nothing() -> None:
    model = plant("omni4", joint_inertia=0.0)
    model.set_velocity((1.0, 0.5, 2.0))
    run(model, 3.0)
    assert model.pose == pytest.approx((3.0, 1.5, 6.0), abs=1e-4)


# -- omni -------------------------------------------------------------------------------------------------------------


def test_omni_rows_of_one_wheel_by_hand() -> None:
    # Axle to the left at x = 0.3: the wheel drives along -x and, turning counter-clockwise, is not moved at all.
    robot = config("omni4").robot
    assert isinstance(robot, OmniRobot)
    wheel = robot.wheel[0].model_copy(update={"x": 0.3, "y": 0.0, "axis_angle": pi / 2.0, "radius": 0.1})
    chassis = omni.chassis(robot.model_copy(update={"wheel": [wheel, *robot.wheel[1:]]}), robot.body)
    assert chassis.rows[0] == pytest.approx((-10.0, 0.0, 0.0), abs=1e-12)
    # The same axle at y = 0.2: turning counter-clockwise moves the wheel along -x with 0.2 m/s per rad/s.
    wheel = wheel.model_copy(update={"x": 0.0, "y": 0.2})
    chassis = omni.chassis(robot.model_copy(update={"wheel": [wheel, *robot.wheel[1:]]}), robot.body)
    assert chassis.rows[0] == pytest.approx((-10.0, 0.0, 2.0), abs=1e-12)


@pytest.mark.parametrize("direction", [(0.8, 0.0, 0.0), (0.0, 0.8, 0.0), (0.0, 0.0, 1.5)])
def test_omni_steady_state_under_constant_torque(direction: Vector) -> None:
    friction = 0.2
    model = dynamics("omni4", friction=friction)
    model.set_velocity(direction)
    torques = hold(model, friction)
    model.set_velocity((0.0, 0.0, 0.0))
    run(model, 12.0, torques)
    assert model.twist == pytest.approx(direction, abs=1e-5)
    assert model.rates == pytest.approx(tuple(rows(model) @ np.array(direction)), abs=1e-4)


# -- offset differential ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rates", [(0.4, 0.6, 0.3), (-0.5, 1.0, -0.8), (0.3, -0.9, 0.0)])
def test_offset_pose_at_constant_wheel_speeds_is_the_closed_form(rates: Vector) -> None:
    along, chassis, platform = rates
    offset, seconds = 0.25, 3.0
    model = dynamics("moby", friction=0.18)
    model.set_velocity(rates)
    run(model, seconds, hold(model, 0.18))
    turned = chassis * seconds
    # The axle midpoint runs on a circle of radius along/chassis; the joint sits `offset` ahead of it.
    radius = along / chassis
    x = -offset + radius * sin(turned) + offset * cos(turned)
    y = radius * (1.0 - cos(turned)) + offset * sin(turned)
    assert model.velocity == pytest.approx(rates, abs=1e-9)
    assert model.pose == pytest.approx((x, y, platform * seconds), abs=1e-6)
    assert model.chassis_angle == pytest.approx(turned, abs=1e-9)
    assert model.angles[2] == pytest.approx((platform - chassis) * seconds, abs=1e-9)


def test_offset_twist_is_that_of_the_platform() -> None:
    model = dynamics("moby")
    model.angles = (0.0, 0.0, pi / 2.0)  # the platform looks to the left of the chassis
    model.set_velocity((0.4, 0.8, 0.1))
    assert model.twist == pytest.approx(Twist(0.25 * 0.8, -0.4, 0.1))


def follow(gamma: float, metres: float, *, speed: float = 0.5) -> float:
    """Angle between motion and chassis after the joint was driven along a line, wheels held to its kinematics."""
    model = dynamics("moby")
    model.set_velocity((speed * cos(gamma), speed * sin(gamma) / 0.25, 0.0))
    for _ in range(round(metres / speed / STEP_S)):
        heading = gamma - model.chassis_angle  # of the commanded direction, seen from the chassis
        wanted = (speed * cos(heading), speed * sin(heading) / 0.25, 0.0)
        errors = rows(model) @ (np.array(wanted) - np.array(model.velocity))
        model.step(tuple(float(60.0 * error) for error in errors))
    along, across = model.velocity[0], 0.25 * model.velocity[1]
    return atan2(across, along)


def test_push_is_stable_and_decays_with_distance() -> None:
    after = follow(0.5, 0.25)
    assert tan(after / 2.0) == pytest.approx(tan(0.25) * exp(-1.0), rel=0.02)


def test_pull_is_unstable_and_flips() -> None:
    almost_pull = pi - 0.02
    assert abs(follow(almost_pull, 0.25)) == pytest.approx(pi - 0.02 * exp(1.0), abs=0.005)
    assert abs(follow(almost_pull, 3.0)) < 0.01


def test_push_of_an_experiment_acts_on_the_body() -> None:
    model = dynamics("omni4")
    model.external = (30.0, 0.0, 0.0)
    run(model, 0.1)
    assert model.twist.vx > 0.05
    assert model.twist.vy == pytest.approx(0.0, abs=1e-12)
