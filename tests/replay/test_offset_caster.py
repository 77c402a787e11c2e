"""The plant with the caster: against the other formulation, in energy and momentum, on ice, and where it is hit."""

from collections.abc import Callable
from itertools import pairwise
from math import cos, degrees, inf, pi, remainder, sin, tau
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import load
from replay.sim.plants import PLANTS, plant_of
from replay.sim.plants.contract import PlantName, Point
from replay.sim.plants.offset_caster import OffsetCaster, parameters
from replay.sim.plants.offset_dynamics import OffsetDynamics
from replay.sim.plants.offset_parameters import JOINT, PLATFORM, SETS, SWIVEL, X, Y, trailing
from tests.replay.offset_multipliers import PRESETS
from tests.replay.offset_multipliers import OffsetDynamics as WithMultipliers

Array = NDArray[np.float64]
MOBY = Path(__file__).parents[2] / "deploy" / "robots" / "moby.toml"
H = 1e-3  # s, a substep
TORQUELESS = (0.0, 0.0, 0.0)
SETS_TOO = pytest.mark.parametrize("name", SETS)


def started(
    name: str = "B",
    *,
    heading: float = 0.0,
    swivel: float = 0.0,
    friction: tuple[float, ...] = (0.0,) * 8,
    wheel_axial: float | None = None,
) -> OffsetCaster:
    """At rest, the chassis at this heading and the platform at zero."""
    own = SETS[name]
    axial = own.wheel_axial if wheel_axial is None else wheel_axial
    plant = OffsetCaster(own._replace(friction=friction, wheel_axial=axial), swivel=swivel)
    plant.place((0.0, 0.0, -heading))
    return plant


def swung(step: int) -> tuple[float, float, float]:
    """Torques of a drive that turns everything."""
    return 6.0 * cos(step / 300.0), 5.0 * sin(step / 200.0), 2.0 * cos(step / 100.0)


def run(plant: OffsetCaster, seconds: float, torques: tuple[float, float, float] = TORQUELESS) -> list[float]:
    """The energy before and after each substep."""
    energies = [plant.energy]
    for _ in range(round(seconds / H)):
        plant.step(torques)
        energies.append(plant.energy)
    return energies


def stepped(
    robot: WithMultipliers, place: Array, free: Array, torques: Array, push: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """One substep of the other formulation (Runge-Kutta)."""

    def slope(at: Array, rate: Array) -> tuple[Array, Array]:
        rates = robot.rates(at, rate)
        return rates, robot.forward(at, rates, torques, push(at))[0][3:6]

    q1, w1 = slope(place, free)
    q2, w2 = slope(place + H / 2 * q1, free + H / 2 * w1)
    q3, w3 = slope(place + H / 2 * q2, free + H / 2 * w2)
    q4, w4 = slope(place + H * q3, free + H * w3)
    return place + H / 6 * (q1 + 2 * q2 + 2 * q3 + q4), free + H / 6 * (w1 + 2 * w2 + 2 * w3 + w4)


def caster_joint(at: Array, along: float, across: float) -> Array:
    """A force in chassis axes 0.25 m ahead of the joint, as it acts on all eight coordinates."""
    heading, force = at[PLATFORM] - at[JOINT], np.zeros(8)
    force[X], force[Y] = along * cos(heading) - across * sin(heading), along * sin(heading) + across * cos(heading)
    force[PLATFORM], force[JOINT] = 0.25 * across, -0.25 * across
    return force


# -- the equations ----------------------------------------------------------------------------------------------------


@SETS_TOO
def test_all_eight_coordinates_are_those_of_eight_equations_with_five_multipliers(name: str) -> None:
    """Over 1.5 s with friction in every joint and a push at the caster's joint."""
    friction = (0.2, 0.1, 0.3, 0.0, 0.0, 0.0, 0.01, 0.02)
    plant = started(name, heading=0.4, swivel=0.3, friction=friction)
    inertia = SETS[name].chassis_inertia
    other = WithMultipliers(PRESETS[name]._replace(friction=friction, chassis_inertia=inertia))
    place, free = np.zeros(8), np.zeros(3)
    place[JOINT], place[SWIVEL] = -0.4, 0.3
    for step in range(1500):
        along, across = (-30.0, 40.0) if 500 <= step < 900 else (0.0, 0.0)
        plant.set_force(Point.CASTER_JOINT, along, across)
        plant.step(swung(step))
        push = caster_joint(place, along, across)
        place, free = stepped(
            other,
            place,
            free,
            np.array(swung(step)),
            push=lambda at, along=along, across=across: caster_joint(at, along, across),  # type: ignore[misc]
        )
    assert np.abs(push).max() == 0.0
    assert np.abs(place[:6]).min() > 0.05, "everything moved"
    assert plant.coordinates == pytest.approx(list(place), abs=1e-9)
    assert plant.energy == pytest.approx(other.energy(place, other.rates(place, free)), rel=1e-9)


@SETS_TOO
def test_energy_is_kept_without_torque(name: str) -> None:
    """Over 5 s, the caster thrown round and the chassis flipping: to 1e-9 (measured: 9e-12)."""
    plant = started(name, heading=0.4, swivel=-1.2)
    plant.set_velocity((-0.9, 0.4, 0.3))
    energies = run(plant, 0.3)
    assert plant.swivel > 1.0, "it swung round"
    energies += run(plant, 4.7)
    assert plant.swivel == pytest.approx(trailing(pulled=False), abs=1e-4), "and back, as the chassis flipped"
    assert max(energies) / min(energies) == pytest.approx(1.0, abs=1e-9)


def test_energy_is_what_motors_pushes_and_friction_give() -> None:
    """Work of the torques over the angles, of the forces over the way of their points, of friction over its joints."""
    friction = (0.2, 0.1, 0.3, 0.0, 0.0, 0.0, 0.01, 0.02)
    plant, work = started(heading=0.4, swivel=0.3, friction=friction), 0.0
    plant.set_force(Point.CASTER_JOINT, 3.0, -8.0)
    plant.set_force(Point.JOINT, -5.0, 4.0)

    def power(torques: tuple[float, float, float]) -> float:
        v, w, platform = plant.velocity
        joints = ((v - 0.2 * w) / 0.1, (v + 0.2 * w) / 0.1, platform - w)
        sine, cosine = sin(plant.swivel), cos(plant.swivel)
        along_axle, along_fork = cosine * v + sine * 0.5 * w, sine * v - cosine * 0.5 * w
        swivel, rolling = -along_axle / 0.05 - w, along_fork / 0.05
        slowed = [
            b * rate * rate for b, rate in zip(friction[:3] + friction[6:], (*joints, swivel, rolling), strict=True)
        ]
        driven = sum(torque * rate for torque, rate in zip(torques, joints, strict=True))
        return driven + 3.0 * v - 8.0 * 0.5 * w - 5.0 * v + 4.0 * 0.25 * w - sum(slowed)

    for step in range(3000):
        before = power(swung(step))
        plant.step(swung(step))
        work += H / 2.0 * (before + power(swung(step)))
    assert plant.energy > 0.5
    assert plant.energy == pytest.approx(work, rel=1e-4)


def test_momentum_is_what_the_ground_gives() -> None:
    """Between two substeps, against the inverse dynamics of the same motion in the middle."""
    plant, robot = started(heading=0.4, swivel=0.3), OffsetDynamics(SETS["B"])
    for step in range(700):
        plant.step(swung(step))
    before, place, (v, w, platform) = plant.momentum, plant.coordinates, plant.velocity
    plant.step(swung(700))
    heading = place[PLATFORM] - place[JOINT]
    free = (v * cos(heading) - 0.25 * w * sin(heading), v * sin(heading) + 0.25 * w * cos(heading), platform)
    ground = robot.inverse(place, free, robot.acceleration(place, free, swung(700))).ground
    after = plant.momentum
    assert ((after[0] - before[0]) / H, (after[1] - before[1]) / H) == pytest.approx(ground, rel=5e-3)


@pytest.mark.parametrize("pulled", [False, True])
@pytest.mark.parametrize("start", [-1.3, 0.3, 1.3])
def test_the_caster_swivels_to_the_trailing_side(pulled: bool, start: float) -> None:
    """Driven by its wheels' motors for 2 s (M10: -90 degrees pushed, +90 pulled), the heading held by them."""
    plant = started(swivel=start)
    for _ in range(2000):
        wanted = -0.5 if pulled else 0.5
        v, w, platform = plant.velocity
        both, apart = 60.0 * (wanted - v), 40.0 * w
        plant.step((both + apart, both - apart, -40.0 * platform))
    assert plant.swivel == pytest.approx(trailing(pulled=pulled), abs=2e-3)
    assert trailing(pulled=pulled) == pytest.approx(pi / 2.0 if pulled else -pi / 2.0)


# -- the robot file ---------------------------------------------------------------------------------------------------


def moby() -> OffsetDifferentialRobot:
    robot = load(MOBY)[0].robot
    assert isinstance(robot, OffsetDifferentialRobot)
    return robot


def test_lengths_masses_and_friction_are_those_of_the_robot_file() -> None:
    """131.09 kg in all, shared as in set B; the chassis' centre of mass is as far behind the joint as there."""
    robot = moby()
    found = parameters(robot)
    assert found[:6] == (0.10, 0.25, 0.40, 0.05, 0.25, 0.05)
    masses = [found.chassis_mass, 2.0 * found.wheel_mass, found.platform_mass, found.fork_mass, found.caster_mass]
    assert sum(masses) == pytest.approx(131.09)
    assert found.chassis_mass / found.platform_mass == pytest.approx(105.0 / 21.94795)
    assert found.chassis_offset == pytest.approx(-0.086)
    assert (found.chassis_inertia, found.platform_inertia, found.wheel_axial, found.joint_inertia) == (
        *(1.304, 2.222),
        *(0.05, 0.05),
    )
    assert found.friction == (0.18, 0.18, 0.18, 0.0, 0.0, 0.0, 0.0, 0.0)
    longer = parameters(robot.model_copy(update={"axle_offset": 0.5}))
    assert longer.chassis_offset == pytest.approx(-0.172)


def test_a_robot_without_caster_and_a_kind_without_dynamics_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = moby()
    monkeypatch.delitem(PLANTS["omni"], PlantName.DYNAMICS)
    with pytest.raises(ValueError, match=r"plant = 'dynamics': robot\.caster is missing"):
        plant_of(robot.model_copy(update={"caster": None}), PlantName.DYNAMICS)
    with pytest.raises(ValueError, match=r"plant = 'dynamics': for a robot of kind omni there is 'simple'"):
        plant_of(load(MOBY.with_name("omni4.toml"))[0].robot, PlantName.DYNAMICS)
    assert plant_of(robot, PlantName.SIMPLE).twist == plant_of(robot).twist


@pytest.mark.parametrize("trail", [0.5, 0.8, 10.0])
def test_a_robot_that_could_not_stand_on_its_caster_is_refused(trail: float) -> None:
    """Offset and position are 0.25 m each: trailing by 0.5 m the caster stands on the axle's line."""
    robot = moby()
    caster = robot.caster
    assert caster is not None
    with pytest.raises(ValueError, match=rf"robot\.caster\.trail = {trail:g}: must be below 0\.5 m"):
        plant_of(robot.model_copy(update={"caster": caster.model_copy(update={"trail": trail})}), PlantName.DYNAMICS)


# -- the ground -------------------------------------------------------------------------------------------------------


def test_the_axle_carries_what_statics_say() -> None:
    """Set B, trailing: the centre of mass is 0.17582 m ahead of the axle, the caster's contact 0.45 m: 39.1 % on it."""
    plant = started(swivel=-pi / 2.0)
    left, right = plant.loads
    assert left == pytest.approx(right)
    assert left + right == pytest.approx(132.29075 * 9.81 * (1.0 - 0.17582 / 0.45), rel=1e-4)
    aside = started(swivel=0.0)  # the caster's wheel to the right: it carries less of the left
    left, right = aside.loads
    assert left > right + 50.0
    plant.slope = 0.2
    assert plant.loads[0] == pytest.approx(started(swivel=-pi / 2.0).loads[0] * cos(0.2))


def test_on_ice_the_ground_gives_no_more_than_friction_times_load() -> None:
    """Wheels that spin: total mass times acceleration is just mu times the load, as the caster only rolls along."""
    plant = started(swivel=-pi / 2.0)
    for wheel in plant.wheels:
        plant.set_friction(wheel, 0.05)
    run(plant, 0.3, (30.0, 30.0, 0.0))
    assert plant.slipping == (0, 1)
    before = plant.velocity[0]
    run(plant, 0.1, (30.0, 30.0, 0.0))
    gained = (plant.velocity[0] - before) / 0.1
    rolling = 132.29075 + 0.7 / 2.0  # with the caster's disc
    assert gained == pytest.approx(0.05 * sum(plant.loads) / rolling, rel=1e-6)


@pytest.mark.parametrize("friction", [0.0, 0.02, 0.1, 0.4])
@pytest.mark.parametrize("axial", [0.010357, 0.05])
def test_no_energy_is_made_on_slippery_ground(friction: float, axial: float) -> None:
    """At most what the motors give, and none from nothing; a substep in which a torque jumps may err by 3e-6 of it.

    (Bounds twice what was measured.)
    """
    plant = started(heading=0.4, swivel=-1.2, wheel_axial=axial)
    for wheel in plant.wheels:
        plant.set_friction(wheel, friction)
    work = 0.0
    for step in range(3000):
        torques = tuple(2.0 * torque for torque in swung(step))
        angles = plant.angles
        plant.step((torques[0], torques[1], torques[2]))
        work += sum(torque * (new - old) for torque, new, old in zip(torques, plant.angles, angles, strict=True))
        assert plant.energy <= work + 2e-5 * max(1.0, plant.energy)
    energies = run(plant, 2.0)
    assert all(after <= before * (1.0 + 5e-6) for before, after in pairwise(energies))
    assert energies[-1] <= energies[0] * (1.0 + 1e-5)


@pytest.mark.parametrize("plant", PlantName)
@pytest.mark.parametrize(("inertia", "drag", "viscous"), [(1e-5, 0.0, 0.18), (1e-3, 1.3, 0.18), (0.05, 50.0, 0.0)])
def test_friction_only_slows_a_loose_wheel_however_light_it_is(
    plant: PlantName, inertia: float, drag: float, viscous: float
) -> None:
    """Explicitly it would turn the wheel round in each substep, ever faster: joint_friction H/joint_inertia is 18."""
    robot = moby()
    update = {"joint_inertia": inertia, "joint_drag": drag, "joint_friction": viscous}
    own = plant_of(robot.model_copy(update={"body": robot.body.model_copy(update=update)}), plant)
    for wheel in own.wheels:
        own.set_friction(wheel, 0.0)
    for _ in range(5):
        own.step((60.0, -60.0, 0.0))
    energies = [own.energy]
    for _ in range(500):
        own.step(TORQUELESS)
        energies.append(own.energy)
    assert energies[0] > 1e-6
    assert all(after <= before for before, after in pairwise(energies))


def test_wheels_that_grip_move_as_wheels_that_cannot_slip() -> None:
    held, free = started(heading=0.4, swivel=-1.2), started(heading=0.4, swivel=-1.2)
    for wheel in free.wheels:
        free.set_friction(wheel, 5.0)
    for step in range(1000):
        held.step(swung(step))
        free.step(swung(step))
        assert free.slipping == ()
    assert free.coordinates == pytest.approx(held.coordinates, abs=2e-5)
    for wheel in free.wheels:
        free.set_friction(wheel, inf)
    assert free.velocity == pytest.approx(held.velocity, abs=1e-5)


# -- impacts ----------------------------------------------------------------------------------------------------------


class Impact:
    """M17, as science 1.7 has it: 4000 N for 25 ms across the chassis at the caster's joint, pulled at 1.2 m/s.

    Each millisecond the motors get what would bring the joint to its (compensated) velocity in that millisecond, up to
    their limit.
    """

    def __init__(self, *, limit: float, gain: float) -> None:
        """Drives for 4 s; `errors`: of gamma, degrees, and `times`, s since the hit."""
        plant = started(heading=pi, swivel=pi / 2.0)
        plant.set_velocity((-1.2, 0.0, 0.0))
        self.errors: list[float] = []
        self.times: list[float] = []
        for step in range(4000):
            plant.set_force(Point.CASTER_JOINT, 0.0, 4000.0 if 1000 <= step < 1025 else 0.0)
            error = remainder(-plant.chassis_angle - pi, tau)
            turned = -gain * error if abs(error) <= pi / 2.0 else 0.0
            plant.step(self._torques(plant, turned - plant.chassis_angle, limit))
            self.errors.append(degrees(error))
            self.times.append((step - 1000) * H)

    @staticmethod
    def _torques(plant: OffsetCaster, direction: float, limit: float) -> tuple[float, float, float]:
        wanted = (1.2 * cos(direction), 1.2 * sin(direction) / 0.25, 0.0)
        change = tuple((new - now) / H for new, now in zip(wanted, plant.velocity, strict=True))
        torques = plant.torques_for((change[0], change[1], change[2]))
        left, right, joint = (max(-limit, min(limit, torque)) for torque in torques)
        return left, right, joint

    @property
    def largest(self) -> float:
        return max(map(abs, self.errors))

    @property
    def settled(self) -> float:
        """s after the hit from which on the error stays below 5 degrees."""
        return max(time for time, error in zip(self.times, self.errors, strict=True) if abs(error) > 5.0)


def test_compensation_recovers_from_an_impact_m17() -> None:
    """53.3 degrees at most, below 5 after 0.775 s: the figures of science 1.7."""
    hit = Impact(limit=75.5, gain=2.0)
    assert hit.largest == pytest.approx(53.0, abs=8.0)
    assert hit.settled < 1.0
    assert abs(hit.errors[-1]) < 0.1


@pytest.mark.parametrize(("limit", "gain"), [(75.5, 0.0), (20.0, 2.0)])
def test_without_compensation_or_with_weak_motors_it_flips_m17(limit: float, gain: float) -> None:
    """And stays flipped: gamma is 180 degrees from its goal, so it is pushed."""
    hit = Impact(limit=limit, gain=gain)
    assert abs(hit.errors[-1]) == pytest.approx(180.0, abs=0.1)
