"""The dynamics plant of the ODD: its equations against Lagrange's, what they keep, falls, slides and slip."""

import random
from math import cos, inf, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from gateway.chassis.odd import OddRobot
from gateway.config import load
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants.contract import WithAttitude, WithSlides
from replay.sim.plants.odd import OddPlant
from replay.sim.plants.odd_bodies import WIDTH, Leaning, OddBodies, OddParameters, inverse, parameters
from replay.sim.plants.odd_dynamics import FALLEN, GRAVITY, OddDynamics
from replay.sim.plants.odd_equations import TwoBodies

ROBOT = Path(__file__).parents[2] / "deploy" / "robots" / "odd.toml"
EXAMPLE = Leaning(height=0.2, pitch_inertia=0.1)  # with 8 kg: the example plant of science 3
EVEN = (0.0,) * 4


def robot(**body: float) -> OddRobot:
    found = load(ROBOT)[0].robot
    assert isinstance(found, OddRobot)
    return found.model_copy(update={"body": found.body.model_copy(update=body)})


def made(leaning: Leaning | None = EXAMPLE, *, mass: float = 8.0, **changed: float) -> OddParameters:
    """Without losses unless told."""
    own = robot(mass=mass, inertia=0.5, joint_friction=0.0, joint_drag=0.0, centre_height=0.12)
    return OddParameters(**(parameters(own, leaning)._asdict() | changed))


def plant(leaning: Leaning | None = EXAMPLE, *, mass: float = 8.0, **changed: float) -> OddDynamics:
    return OddDynamics(made(leaning, mass=mass, **changed), width=0.4)


def run(one: OddDynamics, seconds: float, torques: tuple[float, ...] = EVEN) -> OddDynamics:
    for _ in range(round(seconds / STEP_S)):
        one.step(torques)
    return one


def potential(one: OddDynamics, p: OddParameters) -> float:
    height = 0.0 if p.leaning is None else p.leaning.height
    up = height * cos(one.pitch) * cos(one.slope) + (one.pose.x + height * sin(one.pitch) * cos(one.pose.theta)) * sin(
        one.slope
    )
    return p.mass * GRAVITY * up


# -- the equations ----------------------------------------------------------------------------------------------------


class Lagrange:
    """Two rigid bodies and a load, from where their centres of mass are: generalised forces of a motion."""

    NAMES = "left right load height upright side pitching"

    def __init__(self) -> None:
        t = sp.symbols("t")
        self.constants = sp.symbols(self.NAMES)
        left, right, load, height, upright, side, pitching = self.constants
        q = [sp.Function(name)(t) for name in ("x", "y", "a", "d", "p")]
        x, y, heading, width, pitch = q
        turn = sp.rot_axis3(-heading) * sp.rot_axis2(-pitch)  # body to world: about the vertical, then the axle
        spin = turn.T * sp.diff(turn, t)
        rates = sp.Matrix([spin[2, 1], spin[0, 2], spin[1, 0]])
        energy = (side * rates[0] ** 2 + pitching * rates[1] ** 2 + upright * rates[2] ** 2) / 2
        for mass, place in ((left, width / 2), (right, -width / 2), (load, 0)):
            velocity = sp.diff(sp.Matrix([x, y, 0]) + turn * sp.Matrix([0, place, height]), t)
            energy += mass * velocity.dot(velocity) / 2
        forces = [sp.diff(sp.diff(energy, sp.diff(one, t)), t) - sp.diff(energy, one) for one in q]
        numbers = [sp.symbols(f"{word}:5") for word in ("change", "rate", "at")]
        derived = [sp.diff(one, t, order) for order in (2, 1, 0) for one in q]  # the highest first
        named = dict(zip(derived, [one for names in numbers for one in names], strict=True))
        plain = [force.subs(named) for force in forces]
        self._forces = sp.lambdify([*numbers, self.constants], plain, modules="math", cse=True)

    def of(self, at: list[float], rate: list[float], change: list[float], constants: list[float]) -> list[float]:
        """At these coordinates; x and y in the axes of the world."""
        return [float(force) for force in self._forces(change, rate, at, constants)]


@pytest.fixture(scope="module")
def lagrange() -> Lagrange:
    return Lagrange()


def in_heading(vector: list[float], angle: float) -> list[float]:
    x, y, *rest = vector
    return [cos(angle) * x + sin(angle) * y, cos(angle) * y - sin(angle) * x, *rest]


@pytest.mark.parametrize("seed", range(6))
def test_the_equations_are_those_of_lagrange(lagrange: Lagrange, seed: int) -> None:
    """Of unequal halves with a load, anywhere and moving anyhow."""
    chance = random.Random(seed)
    p = made(Leaning(chance.uniform(0.1, 0.5), 0.3), left=3.0, right=5.0, load=1.5, upright=0.2, side=0.7)
    assert p.leaning is not None
    at, rate, change = ([chance.uniform(-2.0, 2.0) for _ in range(5)] for _ in range(3))
    at[3], at[4] = 0.45, chance.uniform(-1.2, 1.2)
    forces = lagrange.of(at, rate, change, [3.0, 5.0, 1.5, p.leaning.height, 0.2, 0.7, 0.3])
    w, bodies = rate[2], OddBodies(p)
    u, (ax, ay, *others) = in_heading(rate, at[2]), in_heading(change, at[2])
    changes = [ax + w * u[1], ay - w * u[0], *others]  # of the numbers, in axes that turn
    ours = np.array(bodies.matrix(at[3], at[4])) @ changes + bodies.bias(at[3], at[4], u)
    assert ours == pytest.approx(in_heading(forces, at[2]), rel=1e-9, abs=1e-9)


def test_on_casters_they_are_the_two_bodies_of_the_corrected_equations() -> None:
    """9 to 11 of the paper, corrected: the forces of both pairs, summed along each axis."""
    p = made(None, left=3.5, right=2.5, upright=0.0)
    u, changes, width = [0.4, -0.3, 1.2, 0.25, 0.0], [0.5, 0.7, -0.9, 0.3, 0.0], 0.45
    pairs = TwoBodies(3.5, 2.5).forces(width, tuple(u[:4]), tuple(changes[:4]))  # type: ignore[arg-type]
    (lx, ly), (rx, ry) = pairs
    summed = [lx + rx, ly + ry, 0.5 * width * (rx - lx), 0.5 * (ly - ry)]
    ours = np.array(OddBodies(p).matrix(width, 0.0)) @ changes + OddBodies(p).bias(width, 0.0, u)
    assert ours[:4] == pytest.approx(summed, rel=1e-12)


def test_the_inverse_is_one_with_rows_held_or_not() -> None:
    chance = np.random.default_rng(1)
    root = chance.normal(size=(5, 5))
    matrix = root @ root.T + np.eye(5)
    for held in ((), (4,), (3,), (3, 4)):
        free = [place for place in range(5) if place not in held]
        expected = np.zeros((5, 5))
        expected[np.ix_(free, free)] = np.linalg.inv(matrix[np.ix_(free, free)])
        assert np.array(inverse(matrix.tolist(), held)) == pytest.approx(expected, abs=1e-12)


# -- the pendulum -----------------------------------------------------------------------------------------------------


def test_the_linearised_pendulum_is_that_of_the_example() -> None:
    """J p'' = m g l p - m l v': 8 kg, 0.2 m, 0.1 kg m^2, so J = 0.42."""
    p = made()
    bodies, tilt = OddBodies(p), 1e-5
    row = bodies.matrix(0.4, tilt)[4]
    assert row[4] == pytest.approx(0.42)
    assert row[0] == pytest.approx(8.0 * 0.2, rel=1e-9)
    force = bodies.driven(0.4, tilt, (0.0, 0.0, -8.0 * GRAVITY))[4]
    assert force / tilt == pytest.approx(8.0 * GRAVITY * 0.2, rel=1e-9)


def test_the_plant_falls_as_that_equation_says_when_its_wheels_are_driven_so() -> None:
    """Evenly accelerated against the lean, as J p'' = m g l sin(p) - m l cos(p) v' says, by steps of its own."""
    one, at, rate = plant(), 0.05, 0.0
    one.lean(at)
    speed = 0.0
    for _ in range(300):
        torque = (8.0 + 16.0) * 0.0762 / 4.0 * 0.1
        before = one.twist.vx
        one.step((torque,) * 4)
        acceleration = (one.twist.vx - before) / STEP_S
        middle = at + 0.5 * STEP_S * rate
        change = (8.0 * GRAVITY * 0.2 * sin(middle) - 8.0 * 0.2 * cos(middle) * acceleration - 4.0 * torque) / 0.42
        speed += acceleration * STEP_S
        at, rate = at + STEP_S * (rate + 0.5 * STEP_S * change), rate + STEP_S * change
    assert one.pitch == pytest.approx(at, rel=0.05)
    assert abs(one.pitch) > 0.1


@pytest.mark.parametrize("tilt", [1e-3, -0.02, 0.3])
def test_what_falls_keeps_its_energy_until_it_lies(tilt: float) -> None:
    p = made()
    one = OddDynamics(p, width=0.4)
    one.lean(tilt)
    total = one.energy + potential(one, p)
    kinetic = 0.0
    for _ in range(3000):
        if one.fallen:
            break
        kinetic = one.energy
        assert kinetic + potential(one, p) == pytest.approx(total, abs=1e-5 * p.mass * GRAVITY * 0.2)
        one.step(EVEN)
    assert kinetic > 1.0
    assert one.pitch == (FALLEN if tilt > 0.0 else -FALLEN)
    assert one.pitch_rate == 0.0


def test_a_turning_leaning_widening_robot_keeps_its_energy_on_a_slope() -> None:
    p = made(left=3.0, right=5.0, load=0.5)
    one = OddDynamics(p, width=0.35)
    one.slope = 0.05
    run(one, 0.2, (0.3, -0.4, 0.4, -0.2))
    total = one.energy + potential_of(one, p)
    assert one.energy > 0.1
    run(one, 0.15)
    assert min(abs(one.twist.wz), abs(one.pitch), abs(one.width_rate)) > 0.02
    assert not one.fallen
    assert one.energy + potential_of(one, p) == pytest.approx(total, rel=1e-4)


def potential_of(one: OddDynamics, p: OddParameters) -> float:
    """Of unequal halves too."""
    assert p.leaning is not None
    off = 0.5 * one.width * (p.left - p.right) / p.mass
    x = one.pose.x + p.leaning.height * sin(one.pitch) * cos(one.pose.theta) - off * sin(one.pose.theta)
    return p.mass * GRAVITY * (p.leaning.height * cos(one.pitch) * cos(one.slope) + x * sin(one.slope))


def test_how_long_a_free_fall_takes() -> None:
    """Over wheels that roll freely the axle gives way: p = p0 cosh(k t), k^2 = m g l / (J - (m l)^2 / whole mass)."""
    one, p = plant(), made()
    joints = 4.0 * p.joint_inertia
    # by elimination of vx from the two rows, wheels' inertia included
    mass, mixed, own = 8.0 + joints / 0.0762**2, 1.6 - joints / 0.0762, 0.42 + joints
    k = sqrt(8.0 * GRAVITY * 0.2 / (own - mixed * mixed / mass))
    one.lean(1e-3)
    steps = 0
    while one.pitch < 0.02 and steps < 3000:
        one.step(EVEN)
        steps += 1
    expected = np.arccosh(20.0) / k
    assert steps * STEP_S == pytest.approx(expected, abs=2e-3)
    assert 0.2 < expected < 1.0


def test_the_motors_push_the_body_back() -> None:
    """Torques that drive it forward make it nod backward; without lean that is all that moves it at first."""
    one = run(plant(), 0.01, (0.5,) * 4)
    assert one.twist.vx > 0.0
    assert one.pitch < 0.0
    force = np.array(one._matrix_now()) @ one._u
    assert force[4] == pytest.approx(-4.0 * 0.5 * 0.01, rel=1e-2)
    assert force[0] == pytest.approx(4.0 * 0.5 / 0.0762 * 0.01, rel=1e-2)


def test_an_encoder_tells_the_wheel_against_the_body() -> None:
    one = plant()
    one.place((1.0, 2.0, 3.0, 4.0))
    one.lean(0.1)
    assert one.angles == pytest.approx((0.9, 1.9, 2.9, 3.9))
    assert one.pose.x == 0.0
    run(one, 0.2, (0.1, 0.1, 0.1, 0.1))
    for angle, start in zip(one.angles, (1.0, 2.0, 3.0, 4.0), strict=True):
        assert angle == pytest.approx(start + one.pose.x / 0.0762 - one.pitch, abs=1e-6)
    assert one.rates == pytest.approx((one.twist.vx / 0.0762 - one.pitch_rate,) * 4)


@pytest.mark.parametrize("friction", [inf, 0.2])
def test_a_fallen_body_lies_and_drags_while_its_wheels_turn(friction: float) -> None:
    one = plant()
    for joint in one.wheels:
        one.set_friction(joint, friction)
    one.lean(0.9, 2.0)
    run(one, 1.0)
    assert one.fallen
    where = one.pitch
    run(one, 2.0)
    assert abs(one.twist.vx) < 1e-3
    run(one, 0.5, (1.5,) * 4)
    assert one.pitch == where == FALLEN
    assert one.twist.vx > (0.1 if friction > 1.0 else -1e-9)
    assert min(one.rates) > 1.0
    one.lean(0.0)
    assert not one.fallen


def test_on_casters_it_stands_whatever_happens_and_cannot_be_tipped() -> None:
    one = plant(None)
    one.push = 30.0
    run(one, 1.0, (0.5, -0.2, 0.4, 0.1))
    assert (one.pitch, one.pitch_rate) == (0.0, 0.0)
    with pytest.raises(ValueError, match="does not lean"):
        one.lean(0.1)
    with pytest.raises(ValueError, match=r"pitch = 1\.2 rad: must be less than 1.05"):
        plant().lean(1.2)


@pytest.mark.parametrize("heading", [0.0, 0.4, pi / 2.0, -2.0])
@pytest.mark.parametrize("pitch", [0.0, 0.2])
def test_the_attitude_is_against_the_plumb_line(heading: float, pitch: float) -> None:
    one = plant()
    one.slope, one.pitch = 0.1, pitch
    one.pose = one.pose._replace(theta=heading)
    told = one.attitude
    roll, tilt = sp.rot_axis1(-told.roll), sp.rot_axis2(-told.pitch)
    plumb = (tilt * roll).T * sp.Matrix([0, 0, 1])  # in the body
    slope = sp.rot_axis2(one.slope)  # of the floor: up along x, so its nose is up
    body = sp.rot_axis3(-heading) * sp.rot_axis2(-pitch)
    seen = (slope * body).T * sp.Matrix([0, 0, 1])
    assert [float(one_) for one_ in plumb] == pytest.approx([float(one_) for one_ in seen], abs=1e-12)


def test_it_has_slides_and_an_attitude() -> None:
    one = plant(None)
    assert isinstance(one, WithAttitude)
    assert isinstance(one, WithSlides)


def test_on_casters_its_attitude_is_that_of_the_slope() -> None:
    one = plant(None)
    assert tuple(one.attitude) == (0.0, 0.0, 0.0, 0.0, 0.0)
    one.slope = 0.1
    assert one.attitude.pitch == pytest.approx(-0.1)
    one.pose = one.pose._replace(theta=pi / 2.0)
    assert one.attitude.roll == pytest.approx(-0.1)


# -- slides -----------------------------------------------------------------------------------------------------------


def widening(one: OddDynamics, torque: float = 0.4) -> tuple[float, ...]:
    """Torques that drive the width alone, as the rows say."""
    rows = np.array(one._rows(one.width))[:, :4]
    return tuple(float(x) for x in torque * np.linalg.solve(rows.T, [0.0, 0.0, 0.0, rows[0][0]]))


def test_the_slides_end_at_both_ends() -> None:
    for sign, end in ((1.0, 0.6), (-1.0, 0.25)):
        one = plant(None)
        run(one, 3.0, widening(one, 0.2 * sign))
        assert one.width == end
        assert one.width_rate == 0.0
        angles = one.angles
        run(one, 0.5, widening(one, 0.2 * sign))
        assert one.width == end
        assert one.angles == pytest.approx(angles, abs=1e-9), "held, and not only put back"
        run(one, 1.0, widening(one, -0.2 * sign))
        assert abs(one.width - end) > 0.01


def test_slides_have_friction() -> None:
    held = plant(None, slide_drag=8.0)
    free, slow = plant(None), plant(None, slide_friction=50.0)
    for one in (held, free, slow):
        run(one, 0.2, widening(one, 0.4))
    assert free.width - 0.4 > 0.01
    assert 0.0 < slow.width - 0.4 < 0.8 * (free.width - 0.4)
    assert held.width - 0.4 < 0.1 * (free.width - 0.4)


def test_turning_pulls_the_halves_apart() -> None:
    """m/4 d'' = m d wz^2 / 4 without anything else."""
    one = plant(None, joint_inertia=0.0)
    one._u[2] = 1.5
    before, momentum = one.energy, one._matrix_now()[2][2] * 1.5
    run(one, 0.4)
    assert one.width > 0.44
    assert one._matrix_now()[2][2] * one.twist.wz == pytest.approx(momentum, rel=1e-6)
    assert one.energy == pytest.approx(before, rel=1e-6)
    assert one.twist.wz < 1.5


def test_rollers_resist_what_goes_sideways_alone() -> None:
    losses = {}
    for drag in (0.0, 0.02):
        for name, place in (("forward", 0), ("left", 1)):
            one = plant(None, roller_drag=drag)
            one._u[place] = 0.5
            run(one, 0.3)
            losses[name, drag] = 0.5 - one._u[place]
    assert losses["forward", 0.0] == losses["forward", 0.02] == losses["left", 0.0] == 0.0
    mass = 8.0 + 4.0 * 0.004 / 0.0762**2
    expected = 0.02 * 8.0 * GRAVITY * sqrt(2.0) / mass * 0.3
    assert losses["left", 0.02] == pytest.approx(expected, rel=0.02)


# -- slip -------------------------------------------------------------------------------------------------------------


def test_a_wheel_pushes_by_no_more_than_its_friction() -> None:
    """All four spinning forward: mu m g along the rollers' axles, so cos 45 of it along x."""
    one = plant(None)
    for joint in one.wheels:
        one.set_friction(joint, 0.3)
    run(one, 0.3, (6.0,) * 4)
    assert one.slipping == one.wheels
    assert one.twist.vx == pytest.approx(0.3 * 0.3 * GRAVITY * cos(pi / 4.0), rel=1e-3)
    assert one.twist.vy == pytest.approx(0.0, abs=1e-9)


def test_below_the_limit_nothing_slips_and_slippery_ground_changes_nothing() -> None:
    torques = (0.25, -0.03, 0.22, -0.03)
    gripping, slippery = plant(None), plant(None)
    for joint in slippery.wheels:
        slippery.set_friction(joint, 0.6)
    for _ in range(500):
        gripping.step(torques)
        slippery.step(torques)
        assert slippery.slipping == ()
    assert slippery.twist == pytest.approx(gripping.twist, rel=2e-3)
    assert slippery.width == pytest.approx(gripping.width, abs=2e-4)


def test_a_body_over_spinning_wheels_feels_the_floor_and_not_the_motors() -> None:
    """On ice a balancing robot's motors can do no more than the floor takes: it falls."""
    one = plant()
    for joint in one.wheels:
        one.set_friction(joint, 0.001)
    one.lean(0.1)
    run(one, 0.3, (2.0,) * 4)
    grips = plant()
    grips.lean(0.1)
    run(grips, 0.1, (2.0,) * 4)
    assert one.slipping == one.wheels
    assert one.pitch > 0.12
    assert grips.pitch < 0.1


def test_sideways_load_goes_to_the_other_wheels() -> None:
    one = plant(None)
    for joint in one.wheels:
        one.set_friction(joint, 5.0)
    assert one.loads == pytest.approx((2.0 * GRAVITY,) * 4)
    rows = np.array(one._rows(0.4))[:, :4]
    run(one, 0.1, tuple(np.linalg.solve(rows.T, [0.0, 8.0, 0.0, 0.0]).tolist()))
    acceleration = one.twist.vy / 0.1
    assert acceleration > 0.3
    places = np.array([0.25, 0.15, -0.15, -0.25])
    assert sum(one.loads) == pytest.approx(8.0 * GRAVITY)
    assert places @ np.array(one.loads) == pytest.approx(-8.0 * acceleration * 0.12, rel=0.02)


def test_unequal_halves_stand_unequally_and_veer() -> None:
    one = plant(None, left=5.0, right=3.0)
    left, _, _, right = one.loads
    assert left > right
    run(one, 0.3, (0.3,) * 4)
    assert one.twist.wz > 0.01, "the lighter half runs ahead"


def test_it_is_the_simple_plant_where_that_is_right() -> None:
    """On casters, equal halves: the same robot by both, within what their steps differ."""
    own = robot()
    simple, full = OddPlant(own), OddDynamics(parameters(own), width=own.width)
    for number in range(2000):
        torques = tuple(0.8 * sin(number / 150.0 + place) for place in range(4))
        simple.step(torques)
        full.step(torques)
    assert full.pose == pytest.approx(simple.pose, abs=5e-3)
    assert full.twist == pytest.approx(simple.twist, abs=5e-3)
    assert full.width == pytest.approx(simple.width, abs=2e-3)


def test_a_wheel_creeps_in_proportion_to_speed_and_push() -> None:
    """Pushed with a tenth of its weight at 0.5 m/s, held by its wheels, it gives way by creep 0.1 / cos^2 of 45."""
    one = plant(None, creep=0.05)
    for joint in one.wheels:
        one.set_friction(joint, 0.6)
    one._u[0], one.push = 0.5, 0.1 * 8.0 * GRAVITY
    one._spins = dict.fromkeys(one.wheels, 0.5 / 0.0762)
    for _ in range(300):
        held = [1.0 * (0.5 / 0.0762 - rate) - 0.1 * 8.0 * GRAVITY * 0.0762 / 4.0 for rate in one.rates]
        one.step(tuple(held))
    creep = 0.05 * 0.1 * 2.0
    assert one.twist.vx / 0.0762 == pytest.approx(one.rates[0] * (1.0 + creep), rel=1e-3)
    assert one.slipping == ()


def test_what_is_held_by_an_end_is_not_stopped_there_again() -> None:
    """Of a wheel that is pressed against its stop on slippery ground rounding leaves some 1e-14 m/s outward."""
    one = plant()
    one._u[WIDTH] = 1e-14
    one._stop(WIDTH, one._middle((WIDTH,)))
    assert one._u == [0.0] * len(one._u)
