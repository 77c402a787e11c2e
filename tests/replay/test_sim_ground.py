"""Push, slope, mass and slippery ground under the simulated chassis."""

from itertools import pairwise
from math import cos, hypot, inf, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.rigid_body import GRAVITY, RigidBody, Vector
from tests.replay.test_rigid_body import NAMES, config, dynamics, plant

WHEELS = {"omni4": (0, 1, 2, 3), "moby": (0, 1)}
SPEED = st.floats(-2.0, 2.0)


def on_ice(name: str, friction: float, *, joint_friction: float = 0.0) -> RigidBody:
    model = dynamics(name, friction=joint_friction)
    for joint in WHEELS[name]:
        model.set_friction(joint, friction)
    return model


def run(model: RigidBody, seconds: float, torques: tuple[float, ...] = ()) -> list[float]:
    """Energy before and after every substep."""
    energies = [model.energy]
    for _ in range(round(seconds / STEP_S)):
        model.step(torques or (0.0,) * len(model.angles))
        energies.append(model.energy)
    return energies


def slip(model: RigidBody, joint: int) -> float:
    """How much faster the rim turns than the ground passes, m/s."""
    row = np.array(model._chassis.rows[joint])
    radius = model._chassis.wheel_radii[joint]
    assert radius is not None
    return float(model.rates[joint] - row @ np.array(model.velocity)) * radius


# -- push and slope ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heading", [0.0, 0.7, pi, -2.0])
def test_a_push_acts_along_world_x_whatever_the_heading(heading: float) -> None:
    model = plant("omni4", joint_inertia=0.0)
    model.pose = model.pose._replace(theta=heading)
    model.push = 50.0
    run(model, 0.05)
    twist = model.twist
    along = twist.vx * cos(heading) - twist.vy * sin(heading)
    across = twist.vx * sin(heading) + twist.vy * cos(heading)
    assert along == pytest.approx(50.0 * 0.05 / 25.0)
    assert across == pytest.approx(0.0, abs=1e-12)


def test_a_push_moves_the_offset_robot_sideways_too() -> None:
    """With the chassis across the push, the joint can only swing about the axle."""
    model = dynamics("moby")
    model.angles = (0.0, 0.0, -pi / 2.0)  # chassis at +90 degrees
    model.push = 100.0
    run(model, 0.05)
    assert model.velocity[0] == pytest.approx(0.0, abs=1e-3)
    assert model.velocity[1] < 0.0
    assert model.twist.vx > 0.01


@pytest.mark.parametrize("name", NAMES)
def test_work_of_a_push_becomes_energy(name: str) -> None:
    model = dynamics(name)
    model.push = 30.0
    x = model.pose.x
    energies = run(model, 1.0)
    assert energies[-1] == pytest.approx(30.0 * (model.pose.x - x), rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_free_robot_runs_down_a_slope(name: str) -> None:
    model = dynamics(name)
    model.slope = 0.1
    run(model, 1.0)
    assert -GRAVITY * sin(0.1) <= model.twist.vx < -0.7 * GRAVITY * sin(0.1)


@pytest.mark.parametrize("name", NAMES)
def test_a_slope_takes_as_much_going_up_as_it_gives_back(name: str) -> None:
    model = dynamics(name)
    model.set_velocity((1.0, 0.0, 0.0))
    model.slope = 0.2
    before = model.energy
    mass = config(name).robot.body.mass
    for energy in run(model, 0.3)[-1:]:
        assert energy + mass * GRAVITY * sin(0.2) * model.pose.x == pytest.approx(before, rel=1e-4)


# -- mass -------------------------------------------------------------------------------------------------------------


def loaded(name: str, mass: float) -> tuple[RigidBody, RigidBody]:
    """A robot in motion, and the same one after its mass became this."""
    before, after = plant(name), plant(name)
    for model in (before, after):
        model.set_velocity((1.0, 0.0, 0.0))
    after.set_mass(mass)
    return before, after


@pytest.mark.parametrize("name", NAMES)
def test_a_load_put_on_slows_the_robot_down_and_takes_energy(name: str) -> None:
    before, after = loaded(name, 300.0)
    assert np.allclose(before._mass @ np.array(before.velocity), after._mass @ np.array(after.velocity))
    assert 0.0 < after.velocity[0] < before.velocity[0]
    assert after.energy < before.energy


@pytest.mark.parametrize("name", NAMES)
def test_a_load_taken_off_leaves_the_speed(name: str) -> None:
    before, after = loaded(name, 10.0)
    assert after.velocity == before.velocity


def test_a_heavier_robot_accelerates_less() -> None:
    models = loaded("omni4", 100.0)
    gained = []
    for model in models:
        start = model.velocity[0]
        run(model, 0.1, (0.5, 0.5, -0.5, -0.5))
        gained.append(abs(model.velocity[0] - start))
    assert gained[1] < 0.35 * gained[0]


# -- slippery ground --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_ground_that_holds_is_no_different_from_none(name: str) -> None:
    """Within the limit the wheel keeps to its row."""
    rough, plain = dynamics(name, friction=0.1), dynamics(name, friction=0.1)
    torques = (0.5, 0.3, -0.4, 0.2)[: len(plain.angles)]
    for model in (rough, plain):
        model.set_velocity((0.4, -0.2, 0.3))
    for joint in WHEELS[name]:
        rough.set_friction(joint, 10.0)
    for model in (rough, plain):
        run(model, 0.5, torques)
    assert rough.slipping == ()
    assert rough.velocity == pytest.approx(plain.velocity, abs=1e-5)
    assert rough.angles == pytest.approx(plain.angles, abs=2e-4)
    assert rough.rates == pytest.approx(plain.rates, abs=1e-4)


@settings(max_examples=15, deadline=None)
@given(
    u=st.tuples(SPEED, SPEED, SPEED),
    spins=st.tuples(*(st.floats(-60.0, 60.0),) * 4),
    friction=st.floats(0.0, 1.0),
)
@pytest.mark.parametrize("name", NAMES)
def test_slip_never_makes_energy(name: str, u: Vector, spins: tuple[float, ...], friction: float) -> None:
    model = on_ice(name, friction)
    model.set_velocity(u)
    model._spins.update({joint: spins[joint] for joint in WHEELS[name]})
    model.set_velocity(u)
    energies = run(model, 0.3)
    assert all(after <= before * (1.0 + 2e-5) + 1e-12 for before, after in pairwise(energies))
    assert energies[-1] <= energies[0] * (1.0 + 2e-5) + 1e-12


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("friction", [0.05, 0.2, 0.6])
def test_torque_beyond_the_limit_spins_the_wheels_and_not_the_robot(name: str, friction: float) -> None:
    model = on_ice(name, friction)
    push = {"omni4": (-40.0, -40.0, 40.0, 40.0), "moby": (200.0, 200.0, 0.0)}[name]
    top = 0.0
    for _ in range(200):
        before = np.array(model.twist[:2])
        model.step(push)
        top = max(top, hypot(*(np.array(model.twist[:2]) - before)) / STEP_S)
    assert model.slipping == WHEELS[name]
    assert all(abs(slip(model, joint)) > 1.0 for joint in WHEELS[name])
    share = 0.5 if name == "moby" else 1.0  # of the weight, on the driven wheels
    assert 0.5 * friction * share * GRAVITY < top <= friction * share * GRAVITY * 1.001


@pytest.mark.parametrize("name", NAMES)
def test_wheels_that_spin_grip_again(name: str) -> None:
    model = on_ice(name, 0.3, joint_friction=0.05)
    torque = {"omni4": (-20.0, -20.0, 20.0, 20.0), "moby": (100.0, 100.0, 0.0)}[name]
    run(model, 0.1, torque)
    assert model.slipping == WHEELS[name]
    energies = run(model, 3.0)
    assert model.slipping == ()
    assert all(slip(model, joint) == pytest.approx(0.0, abs=1e-7) for joint in WHEELS[name])
    assert abs(model.velocity[0]) > 0.01, "what the ground gave, the robot kept"
    assert all(after <= before * (1.0 + 2e-5) for before, after in pairwise(energies))


def test_gripping_keeps_the_momentum_of_wheel_and_body() -> None:
    model = on_ice("omni4", 0.1)
    run(model, 0.2, (-20.0, -20.0, 20.0, 20.0))
    rows = np.array(model._chassis.rows)
    inertia = model._chassis.body.joint_inertia
    before = model._mass @ np.array(model.velocity) + inertia * rows.T @ np.array(model.rates)
    for joint in WHEELS["omni4"]:
        model.set_friction(joint, inf)
    assert model.slipping == ()
    assert np.allclose(model._mass @ np.array(model.velocity), before)


def test_one_wheel_on_ice_leaves_the_others_driving() -> None:
    model = dynamics("omni4")
    model.set_friction(0, 0.02)
    run(model, 0.3, (-2.0, -2.0, 2.0, 2.0))
    assert model.slipping == (0,)
    assert abs(slip(model, 0)) > 1.0
    assert all(slip(model, joint) == pytest.approx(0.0, abs=1e-7) for joint in (1, 2, 3))
    assert model.twist.vx > 0.2
    assert abs(model.twist.wz) > 0.01, "three wheels push unevenly"


def test_locked_wheels_slide_with_friction_times_weight() -> None:
    """A brake that locks the wheels stops a robot within v^2 / (2 mu g), no sooner."""
    model = on_ice("omni4", 0.3)
    model.set_velocity((1.0, 0.0, 0.0))  # and the wheels stand
    for _ in range(2000):
        model.step([-0.5 * rate for rate in model.rates])
    assert model.twist.vx == pytest.approx(0.0, abs=1e-3)
    assert model.pose.x > 1.0 / (2.0 * 0.3 * GRAVITY)


def test_a_slope_steeper_than_friction_lets_the_robot_slide() -> None:
    held, sliding = on_ice("moby", 0.5), on_ice("moby", 0.1)
    for model in (held, sliding):
        model.slope = 0.15
        for _ in range(500):
            model.step([-60.0 * rate for rate in model.rates])
    assert abs(held.twist.vx) < 0.03
    assert sliding.twist.vx < -0.2


def test_only_a_wheel_with_inertia_can_slip() -> None:
    model = dynamics("moby")
    with pytest.raises(ValueError, match="joint 2"):
        model.set_friction(2, 0.1)
