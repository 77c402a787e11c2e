"""The dynamics of robots on omni wheels against Kane's equations that sympy derives from their bodies.

The derivation takes some seconds per number of wheels, once; the rest is numbers at random states.
"""

from math import pi

import numpy as np
import pytest
from numpy.typing import NDArray

from replay.sim.plants.omni_equations import OmniEquations
from replay.sim.plants.omni_parameters import OmniParameters, WheelParameters, kane_robot
from tests.replay.omni_kane import Base, KaneRobot, Wheel

Array = NDArray[np.float64]
SEEDS = range(20)
CLOSE = 1e-11  # of the largest part
INCH, SLUG = 0.0254, 14.593902937206365  # m, kg

# Amarasiri et al. 2022, Tables 1 to 3, in inches and slug: base, discs and tori as one body, rollers.
# Axes as in E-004-4 and 5 of science 5.
_WHEEL = {
    "radius": 3.0,
    "mass": 0.025257 + 0.013697,
    "roller_radius": 0.4,
    "roller_mass": 0.00100613,
    "roller_axial": 0.000110892,
    "roller_upright": 0.000221784,
}
_FIRST = _WHEEL | {"axial": 0.121937 + 0.0946465, "upright": 0.0628245 + 0.0781416}
_LAST = _WHEEL | {"axial": 0.117613 + 0.0946465, "upright": 0.0606622 + 0.0781416}
PAPER = (
    Base(mass=0.0951426, upright=1.39817, x=0.0, y=0.0),
    (
        Wheel(x=0.0, y=8.0, axis_angle=-pi / 2.0, **_FIRST),
        Wheel(x=0.0, y=-8.0, axis_angle=-pi / 2.0, **_FIRST),
        Wheel(x=-8.0, y=0.0, axis_angle=0.0, **_LAST),
        Wheel(x=8.0, y=0.0, axis_angle=0.0, **_LAST),
    ),
)


def drawn(seed: int, count: int) -> tuple[Base, tuple[Wheel, ...]]:
    """Any robot of so many wheels, the centre of mass of everything over the origin."""
    random = np.random.default_rng(seed)
    wheels = tuple(
        Wheel(
            x=random.uniform(-0.4, 0.4),
            y=random.uniform(-0.4, 0.4),
            axis_angle=random.uniform(-pi, pi),
            radius=random.uniform(0.03, 0.1),
            mass=random.uniform(0.1, 3.0),
            axial=random.uniform(1e-3, 5e-2),
            upright=random.uniform(1e-3, 1e-2),
            roller_radius=random.uniform(5e-3, 2e-2),
            roller_mass=random.uniform(0.01, 1.0),
            roller_axial=random.uniform(1e-6, 1e-3),
            roller_upright=random.uniform(1e-6, 1e-4),
        )
        for _ in range(count)
    )
    mass = random.uniform(5.0, 50.0)
    x = -sum((wheel.mass + wheel.roller_mass) * wheel.x for wheel in wheels) / mass
    y = -sum((wheel.mass + wheel.roller_mass) * wheel.y for wheel in wheels) / mass
    return Base(mass, random.uniform(0.1, 3.0), x, y), wheels


def ours(base: Base, wheels: tuple[Wheel, ...]) -> OmniParameters:
    """The same: sums of masses, and of inertias by Steiner's theorem."""
    carried = [wheel.mass + wheel.roller_mass for wheel in wheels]
    turning = base.upright + base.mass * (base.x**2 + base.y**2)
    for wheel, mass in zip(wheels, carried, strict=True):
        turning += wheel.upright + wheel.roller_upright + mass * (wheel.x**2 + wheel.y**2)
    return OmniParameters(
        mass=base.mass + sum(carried),
        inertia=turning,
        wheels=tuple(
            WheelParameters(
                wheel.x,
                wheel.y,
                wheel.axis_angle,
                radius=wheel.radius,
                spin_inertia=wheel.axial,
                roller_radius=wheel.roller_radius,
                roller_inertia=wheel.roller_axial,
            )
            for wheel in wheels
        ),
    )


def assert_close(found: object, expected: Array) -> None:
    """All of it within CLOSE of the largest part."""
    assert np.abs(np.array(found, dtype=float) - expected).max() <= CLOSE * np.abs(expected).max()


def assert_alike(ours: OmniEquations, kane: KaneRobot, seed: int, *, motion_scale: float, torque_scale: float) -> None:
    """At a random state: rates of wheels and rollers, energy, accelerations."""
    random, count = np.random.default_rng(seed), len(ours.parameters.wheels)
    heading = random.uniform(-pi, pi)
    motion = random.uniform(-1.0, 1.0, 3) * (motion_scale, motion_scale, 4.0)
    torques = random.uniform(-torque_scale, torque_scale, count)
    vx, vy, w = map(float, motion)
    assert_close([*ours.joint_rates((vx, vy, w)), *ours.roller_rates((vx, vy, w))], kane.speeds(heading, motion)[3:])
    assert ours.energy((vx, vy, w)) == pytest.approx(kane.energy(heading, motion), rel=CLOSE)
    found = ours.acceleration((vx, vy, w), ours.driven(list(map(float, torques))))
    assert_close(found, kane.acceleration(heading, motion, torques)[:3])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_robot_of_the_paper(seed: int) -> None:
    """In inches and slug, as the paper has it."""
    assert_alike(OmniEquations(ours(*PAPER)), KaneRobot(*PAPER), seed, motion_scale=25.0, torque_scale=120.0)


def test_its_parameters_are_those_of_the_paper_in_other_units() -> None:
    """M = 0.25498 slug; M_eff = 0.3045 along its first axis and 0.3036 along the second (science 4)."""
    paper, si = ours(*PAPER), kane_robot()
    assert si.mass == pytest.approx(SLUG * paper.mass, rel=1e-12)
    assert si.mass / SLUG == pytest.approx(0.25498, abs=5e-6)
    assert si.inertia == pytest.approx(SLUG * INCH**2 * paper.inertia, rel=1e-12)
    for one, other in zip(si.wheels, paper.wheels, strict=True):
        assert (one.x, one.y) == pytest.approx((INCH * other.x, INCH * other.y), abs=1e-15)
        assert one.axis_angle == other.axis_angle
        assert (one.radius, one.roller_radius) == pytest.approx((INCH * other.radius, INCH * other.roller_radius))
        inertias = SLUG * INCH**2 * other.spin_inertia, SLUG * INCH**2 * other.roller_inertia
        assert (one.spin_inertia, one.roller_inertia) == pytest.approx(inertias, rel=1e-12)
    robot = OmniEquations(si)
    assert robot.resistance_to((1.0, 0.0, 0.0))[0] / SLUG == pytest.approx(0.3045, abs=5e-5)
    assert robot.resistance_to((0.0, 1.0, 0.0))[1] / SLUG == pytest.approx(0.3036, abs=1e-4)


@pytest.mark.parametrize("count", [3, 4])
@pytest.mark.parametrize("seed", SEEDS)
def test_any_wheels_at_any_pose(seed: int, count: int) -> None:
    robot = drawn(seed, count)
    assert_alike(OmniEquations(ours(*robot)), KaneRobot(*robot), seed, motion_scale=2.0, torque_scale=10.0)


def test_spin_and_rollers_have_no_coriolis_term() -> None:
    """Without torque the velocity turns in the body as that of the body's own mass: at w M / M_eff, not at w."""
    kane, own = KaneRobot(*PAPER), OmniEquations(ours(*PAPER))
    vx, vy, w = 20.0, 0.0, 3.0
    expected = pytest.approx(-w * vx * 0.25498 / 0.30354, rel=1e-4)
    assert kane.acceleration(0.4, np.array([vx, vy, w]), np.zeros(4))[1] == expected
    assert own.acceleration((vx, vy, w), (0.0, 0.0, 0.0))[1] == expected
