"""The dynamics of omni4 against MuJoCo: its bodies and its loads, with Coulomb friction along each wheel.

Bounds are about twice what was measured with MuJoCo 4.0. What remains is that MuJoCo's body rocks on its contacts, that
the spin of the hubs (a small part of the joints' inertia) tips it, and the mass of our rollers.
"""

from math import cos, pi, sin

import numpy as np
import pytest

from replay.sim.plants.omni_dynamics import OmniDynamics
from tests.replay.mujoco_pads import MujocoPads
from tests.replay.test_omni_dynamics import FIRST_SLIP, accelerating, robot, slips, started

directions = pytest.mark.parametrize("direction", [step * pi / 4.0 for step in range(8)])


def least_norm(direction: float, torque: float) -> list[float]:
    """The largest of so many N m."""
    return [float(one) for one in torque * accelerating(direction)[0]]


def both(torques: list[float], *, friction: float, seconds: float = 0.3) -> tuple[MujocoPads, OmniDynamics]:
    """The same robot twice after so long under these torques."""
    contact = MujocoPads(robot(joint_friction=0.0, joint_drag=0.0), friction)
    plant = started(friction=friction)
    for _ in range(round(seconds / 1e-3)):
        contact.step(torques)
        plant.step(torques)
    return contact, plant


@directions
@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_wheels_that_grip_accelerate_alike_and_carry_alike(direction: float, friction: float) -> None:
    contact, plant = both(least_norm(direction, 1.0 if friction == 0.3 else 1.6), friction=friction)
    assert plant.slipping == ()
    assert np.abs(contact.slips).max() < 1e-3
    assert plant.twist == pytest.approx(contact.twist, abs=1e-3)
    assert plant.rates == pytest.approx(contact.rates, abs=0.02)
    assert plant.loads == pytest.approx(contact.loads, abs=0.2)


@directions
@pytest.mark.parametrize(("friction", "torque"), [(0.3, 1.5), (0.6, 3.0)])
def test_the_wheels_that_slip_are_the_same_and_slip_alike(direction: float, friction: float, torque: float) -> None:
    contact, plant = both(least_norm(direction, torque), friction=friction)
    assert 1 <= len(plant.slipping) <= 2
    assert plant.slipping == tuple(int(place) for place in np.flatnonzero(np.abs(contact.slips) > 0.05))
    assert plant.twist == pytest.approx(contact.twist, abs=2.5e-3)
    assert slips(plant) == pytest.approx(contact.slips, abs=0.07)
    assert plant.loads == pytest.approx(contact.loads, abs=0.4)


@directions
def test_wheels_that_spin_fast_give_alike(direction: float) -> None:
    """6 N m on a floor of 0.6: up to 25 m/s of slip after 0.3 s; now the hubs' spin is felt."""
    contact, plant = both(least_norm(direction, 6.0), friction=0.6)
    assert np.abs(contact.slips).max() > 10.0
    assert plant.twist == pytest.approx(contact.twist, abs=1e-2)
    assert slips(plant) == pytest.approx(contact.slips, abs=0.2)


@pytest.mark.parametrize(("friction", "name", "torque", "acceleration"), FIRST_SLIP)
def test_the_table_of_first_slip_is_mujocos(friction: float, name: str, torque: float, acceleration: float) -> None:
    """3 % below the torque that the table has, no wheel of MuJoCo's slips; 3 % above it, one does."""
    direction = {"forward": 0.0, "left": pi / 2.0, "45 degrees": pi / 4.0}[name]
    below, above = (MujocoPads(robot(joint_friction=0.0, joint_drag=0.0), friction) for _ in range(2))
    for _ in range(300):
        below.step(least_norm(direction, 0.97 * torque))
        above.step(least_norm(direction, 1.03 * torque))
    assert np.abs(below.slips).max() < 5e-3
    assert np.abs(above.slips).max() > 5e-3
    gained = below.twist[0] * cos(direction) + below.twist[1] * sin(direction)
    assert gained / 0.3 == pytest.approx(0.97 * acceleration, rel=0.02)


@pytest.mark.parametrize("dead", range(4))
def test_a_motor_without_torque(dead: int) -> None:
    """It drags its wheel along: the robot veers and yaws alike."""
    torques = [0.0 if place == dead else one for place, one in enumerate((-1.0, -1.0, 1.0, 1.0))]
    contact, plant = both(torques, friction=0.6)
    assert abs(plant.twist.wz) > 0.5
    assert plant.twist == pytest.approx(contact.twist, abs=3e-3)
    assert plant.rates == pytest.approx(contact.rates, abs=0.05)


def test_a_drive_that_grips_slips_and_brakes() -> None:
    """Torques that swing through everything for 1.5 s, with one wheel after the other slipping."""
    contact, plant = MujocoPads(robot(joint_friction=0.0, joint_drag=0.0), 0.3), started(friction=0.3)
    seen: set[int] = set()
    for step in range(1500):
        torques = [2.2 * sin(step / 120.0 + 1.7 * place) for place in range(4)]
        contact.step(torques)
        plant.step(torques)
        seen |= set(plant.slipping)
    assert seen == {0, 1, 2, 3}
    assert plant.twist == pytest.approx(contact.twist, abs=0.02)
