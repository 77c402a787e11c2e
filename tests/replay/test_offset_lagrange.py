"""The dynamics of the offset-differential robot against Lagrange's equations that sympy derives from its bodies.

The derivation takes some seconds, once; the rest is numbers at random states of all four parameter sets.
"""

from math import pi

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from replay.sim.plants.offset_dynamics import SETS, OffsetDynamics
from tests.replay.offset_lagrange import COORDINATES, PARAMETERS, RATES, LagrangeRobot, derived

Array = NDArray[np.float64]
SEEDS = range(10)
states = pytest.mark.parametrize("seed", SEEDS)
sets = pytest.mark.parametrize("name", SETS)
CLOSE = 1e-11  # of the largest part; measured over 200 seeds of each set: 2.7e-13 at the most


class Drawn:
    """Both robots of one set, joints with friction, in a random state that the constraints allow."""

    def __init__(self, name: str, seed: int) -> None:
        random = self.random = np.random.default_rng(seed)
        friction = tuple(random.uniform(0.0, 0.3, 8) * (1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0))
        parameters = SETS[name]._replace(friction=friction)
        self.ours, self.oracle = OffsetDynamics(parameters), LagrangeRobot(parameters)
        self.place, self.free = random.uniform(-pi, pi, 8), random.uniform(-1.5, 1.5, 3)
        self.now = self.ours.moving(self.place, self.free)
        terms = self.oracle.terms(self.place, self.now.rates)
        self.mass, _, self.contacts, self.drift, _, self.caster_joint = terms

    def inertia(self) -> Array:
        """Of ours along the free rates, (3, 3)."""
        units = np.eye(3)
        energies = [self.ours.energy(self.place, unit) for unit in units]
        rows = [
            [
                self.ours.energy(self.place, one + two) - mine - theirs
                for two, theirs in zip(units, energies, strict=True)
            ]
            for one, mine in zip(units, energies, strict=True)
        ]
        return np.array(rows)


def assert_close(found: Array, expected: Array) -> None:
    """All of it within CLOSE of the largest part."""
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() <= CLOSE * max(1.0, np.abs(expected).max())


@sets
@states
def test_the_energy_of_a_motion(name: str, seed: int) -> None:
    """The mass matrix of what is free, entry by entry: twice the energy of two rates at once less that of each."""
    drawn = Drawn(name, seed)
    assert_close(drawn.inertia(), drawn.now.spread.T @ drawn.mass @ drawn.now.spread)
    energy = drawn.now.rates @ drawn.mass @ drawn.now.rates / 2.0
    assert drawn.ours.energy(drawn.place, drawn.free) == pytest.approx(float(energy), rel=CLOSE)


@sets
@states
def test_what_touches_the_floor_stands_still(name: str, seed: int) -> None:
    """All six speeds there are zero whatever the three free rates are, and stay so; nothing more is free."""
    drawn = Drawn(name, seed)
    assert_close(drawn.contacts @ drawn.now.spread, np.zeros((6, 3)))
    assert_close(drawn.contacts @ drawn.now.bias + drawn.drift.ravel(), np.zeros(6))
    assert np.linalg.matrix_rank(drawn.contacts) == 5
    assert np.linalg.matrix_rank(drawn.now.spread) == 3


@sets
@states
def test_forward_accelerations(name: str, seed: int) -> None:
    """Motors, friction of all joints, and a push at the platform joint."""
    drawn = Drawn(name, seed)
    torques, push = drawn.random.uniform(-20.0, 20.0, 3), drawn.random.uniform(-100.0, 100.0, 2)
    expected, _ = drawn.oracle.accelerations(drawn.place, drawn.now.rates, torques, (push, np.zeros(2)))
    found = drawn.ours.acceleration(drawn.place, drawn.free, torques, push)
    assert_close(drawn.now.spread @ found + drawn.now.bias, expected)


@sets
@states
def test_a_push_at_the_joint_of_the_caster(name: str, seed: int) -> None:
    """What it adds: the lever is the oracle's, inertia and free rates are ours."""
    drawn = Drawn(name, seed)
    torques, push = drawn.random.uniform(-20.0, 20.0, 3), drawn.random.uniform(-4000.0, 4000.0, 2)
    expected, _ = drawn.oracle.accelerations(drawn.place, drawn.now.rates, torques, (np.zeros(2), push))
    added = np.linalg.solve(drawn.inertia(), drawn.now.spread.T @ drawn.caster_joint[:2].T @ push)
    found = drawn.ours.acceleration(drawn.place, drawn.free, torques) + added
    assert_close(drawn.now.spread @ found + drawn.now.bias, expected)


@sets
@states
def test_inverse_torques_and_the_force_of_the_ground(name: str, seed: int) -> None:
    """The ground's is the sum of what it does at three contacts, found here one by one."""
    drawn = Drawn(name, seed)
    mine = drawn.ours.inverse(drawn.place, drawn.free, drawn.random.uniform(-2.0, 2.0, 3))
    torques, contacts = drawn.oracle.inverse(drawn.place, drawn.now.rates, mine.acceleration)
    assert_close(np.array(mine.torques), torques)
    assert_close(np.array(mine.ground), contacts.sum(axis=0))
    forward, again = drawn.oracle.accelerations(
        drawn.place, drawn.now.rates, np.array(mine.torques), (np.zeros(2), np.zeros(2))
    )
    assert_close(forward, mine.acceleration)
    assert_close(again.sum(axis=0), contacts.sum(axis=0))


def test_the_caster_rolls_by_the_corrected_rows_and_by_no_printed_one() -> None:
    """science 1.2, symbolically: + d3 beta' sideways (Eq. 6 prints a minus), and Eq. 7 as printed."""
    _, _, joint, _, _, platform, swivel, _ = COORDINATES
    _, _, joint_, x_, y_, platform_, swivel_, caster_ = RATES
    trail, position, radius = (PARAMETERS[name] for name in ("trail", "caster_position", "caster_radius"))
    heading, turn = platform - joint, platform_ - joint_
    vx, vy = derived().contacts[4:, :] * sp.Matrix(RATES)
    across = sp.cos(swivel + heading) * vx + sp.sin(swivel + heading) * vy
    along = sp.sin(swivel + heading) * vx - sp.cos(swivel + heading) * vy
    sideways = sp.cos(swivel + heading) * x_ + sp.sin(swivel + heading) * y_
    sideways += (trail + position * sp.sin(swivel)) * turn
    rolling = sp.sin(swivel + heading) * x_ - sp.cos(swivel + heading) * y_
    rolling -= position * sp.cos(swivel) * turn + radius * caster_
    assert _is_zero(across - (sideways + trail * swivel_))
    assert not _is_zero(across - (sideways - trail * swivel_))
    assert _is_zero(along - rolling)


def _is_zero(expression: sp.Expr) -> bool:
    """Sums of products of sines are, once they are sums of exponentials."""
    return bool(sp.expand(expression.rewrite(sp.exp)) == 0)
