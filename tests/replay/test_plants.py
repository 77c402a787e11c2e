"""The contract of a plant, held by every one in the registry on every bundled robot of its kind."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from gateway.chassis import CHASSIS
from gateway.config import load
from gateway.sections import Body
from gateway.types import ZERO_TWIST, Pose, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import PLANTS, plant_of
from replay.sim.plants.contract import Plant, PlantName, WithSlides

ROBOTS = Path(__file__).parents[2] / "deploy" / "robots"
Torques = tuple[float, ...]
# Per chassis kind: torques that drive every axis at once, N m, and joint angles to begin at, rad.
MIXED: dict[str, Torques] = {
    "omni": (-1.0, 0.4, 1.2, 0.9),
    "mecanum": (-1.0, 0.4, 1.2, 0.9),
    "odd": (0.25, -0.03, 0.22, -0.03),
    "offset_differential": (3.0, 5.0, -2.0),
}
PLACED: dict[str, Torques] = {
    "omni": (0.3, -0.2, 0.1, 7.0),
    "mecanum": (0.3, -0.2, 0.1, 7.0),
    "odd": (0.3, -0.2, 0.1, 7.0),
    "offset_differential": (0.3, -0.2, 1.1),
}


class Subject(NamedTuple):
    """One plant to try: the robot and how the plant is made of it."""

    robot: Any
    make: Callable[[Any], Plant]

    def plant(self, **body: float) -> Plant:
        """As in the robot file, with other figures of its body if asked."""
        changed: Body = self.robot.body.model_copy(update=body)
        return self.make(self.robot.model_copy(update={"body": changed}))

    def frictionless(self) -> Plant:
        return self.plant(joint_friction=0.0, joint_drag=0.0)

    def mixed(self) -> Torques:
        return MIXED[self.robot.kind]


def subjects() -> dict[str, Subject]:
    """Every robot that stands by itself; one that falls is another matter (test_odd_dynamics)."""
    robots = {path.stem: load(path)[0].robot for path in sorted(ROBOTS.glob("*.toml"))}
    del robots["odd_balancing"]
    return {
        f"{name}-{plant.value}": Subject(robot, make)
        for name, robot in robots.items()
        for plant, make in PLANTS[robot.kind].items()
    }


SUBJECTS = subjects()
every = pytest.mark.parametrize("subject", SUBJECTS.values(), ids=SUBJECTS.keys())


def run(plant: Plant, seconds: float, torques: Sequence[float] | None = None) -> list[float]:
    """So long under these torques (None: no torque); the energy before and after each substep."""
    energies = [plant.energy]
    for _ in range(round(seconds / STEP_S)):
        plant.step((0.0,) * len(plant.angles) if torques is None else torques)
        energies.append(plant.energy)
    return energies


def state(plant: Plant) -> tuple[Any, ...]:
    return plant.angles, plant.rates, plant.pose, plant.twist, plant.chassis_angle


def test_every_kind_of_the_registry_has_a_bundled_robot_to_be_tried_on() -> None:
    assert {subject.robot.kind for subject in SUBJECTS.values()} == set(PLANTS) == set(CHASSIS)


# -- rest -------------------------------------------------------------------------------------------------------------


@every
def test_it_begins_at_rest_at_the_origin_and_stays_there_without_torque(subject: Subject) -> None:
    plant = subject.plant()
    assert plant.pose == Pose(0.0, 0.0, 0.0)
    energies = run(plant, 0.5)
    assert max(energies) == 0.0
    assert plant.slipping == ()
    assert state(plant) == state(subject.plant())


@every
def test_joints_are_where_they_are_placed_and_nothing_moved(subject: Subject) -> None:
    plant = subject.plant()
    plant.place(PLACED[subject.robot.kind])
    run(plant, 0.1)
    assert plant.angles == PLACED[subject.robot.kind]
    assert plant.pose == Pose(0.0, 0.0, 0.0)
    assert set(plant.rates) == {0.0}


# -- motion -----------------------------------------------------------------------------------------------------------


@every
def test_energy_does_not_grow_without_torque(subject: Subject) -> None:
    """With the friction of the robot file it falls in every substep; without any it is kept to 1e-5."""
    for plant, least in ((subject.plant(), 0.0), (subject.frictionless(), 1.0 - 1e-5)):
        run(plant, 0.5, subject.mixed())
        energies = run(plant, 2.0)
        assert energies[0] > 0.01
        assert all(after <= before * (1.0 + 1e-8) for before, after in pairwise(energies))
        assert energies[-1] >= least * energies[0]


@every
def test_the_work_of_the_torques_becomes_energy(subject: Subject) -> None:
    plant = subject.frictionless()
    run(plant, 0.5, subject.mixed())
    work = sum(torque * angle for torque, angle in zip(subject.mixed(), plant.angles, strict=True))
    assert plant.energy == pytest.approx(work, rel=1e-4)


def of_the_core(subject: Subject, plant: Plant) -> list[float]:
    """Joint rates as the core's kinematics has them of how the plant moves, width included."""
    kinematics = subject.robot.kinematics()
    if isinstance(plant, WithSlides):
        kinematics.width.metres = plant.width
        return list(kinematics.wheel_speeds((*plant.twist, plant.width_rate), plant.angles))
    return list(kinematics.wheel_speeds(plant.twist, plant.angles))


def mirror(subject: Subject) -> list[tuple[int, float]]:
    """Which joint another one becomes, and with which sign, where left and right change places.

    Read from the rows of the kinematics: vy and wz change their sign, so the row of the image is (a, -b, -c).
    """
    rows = np.array(subject.robot.kinematics().matrix())
    images = rows * [1.0, -1.0, -1.0, 1.0][: rows.shape[1]]  # the pairs of an ODD go apart in the mirror too
    found = [
        (place, sign)
        for image in images
        for place, row in enumerate(rows)
        for sign in (1.0, -1.0)
        if np.allclose(sign * row, image, atol=1e-9)
    ]
    assert len(found) == len(rows), "the robot itself is symmetric"
    return found


@every
def test_mirrored_torques_give_the_mirrored_motion(subject: Subject) -> None:
    torques, image = subject.mixed(), mirror(subject)
    mirrored = [0.0] * len(torques)
    for torque, (place, sign) in zip(torques, image, strict=True):
        mirrored[place] = sign * torque
    left, right = subject.plant(), subject.plant()
    run(left, 1.0, torques)
    run(right, 1.0, mirrored)
    x, y, theta = left.pose
    vx, vy, wz = left.twist
    assert min(abs(y), abs(theta), abs(vy), abs(wz)) > 1e-3, "the drive says something"
    assert right.pose == pytest.approx((x, -y, -theta), rel=1e-9, abs=1e-12)
    assert right.twist == pytest.approx((vx, -vy, -wz), rel=1e-9, abs=1e-12)
    assert right.chassis_angle == pytest.approx(-left.chassis_angle, rel=1e-9)
    assert [right.angles[place] * sign for place, sign in image] == pytest.approx(left.angles, rel=1e-9)
    assert [right.rates[place] * sign for place, sign in image] == pytest.approx(left.rates, rel=1e-9)


@every
def test_the_same_torques_give_the_same_bits(subject: Subject) -> None:
    def drive(plant: Plant) -> tuple[Any, ...]:
        plant.slope, plant.push = 0.02, 15.0
        plant.set_friction(plant.wheels[0], 0.05)
        run(plant, 0.3, subject.mixed())
        plant.set_mass(2.0 * subject.robot.body.mass)
        run(plant, 0.3)
        return (*state(plant), plant.slipping, plant.energy)

    assert drive(subject.plant()) == drive(subject.plant())


@every
def test_joint_rates_are_those_of_the_body_twist_while_no_wheel_slips(subject: Subject) -> None:
    """The kinematics of the core, made from the robot file on a way of its own, says the same of every joint."""
    plant = subject.plant()
    plant.place(PLACED[subject.robot.kind])
    for torques in (subject.mixed(), None, tuple(-2.0 * torque for torque in subject.mixed())):
        run(plant, 0.4, torques)
        assert plant.slipping == ()
        assert of_the_core(subject, plant) == pytest.approx(plant.rates, abs=1e-9)


@every
def test_the_pose_is_the_way_of_the_twist(subject: Subject) -> None:
    plant = subject.plant()
    x = y = 0.0
    run(plant, 0.2, subject.mixed())
    x, y, theta = plant.pose
    for _ in range(500):
        before = world_velocity(plant)
        plant.step(subject.mixed())
        after = world_velocity(plant)
        x, y, theta = (
            at + (old + new) * STEP_S / 2.0 for at, old, new in zip((x, y, theta), before, after, strict=True)
        )
    assert plant.pose == pytest.approx((x, y, theta), abs=1e-5)


def world_velocity(plant: Plant) -> tuple[float, float, float]:
    forward = complex(plant.twist.vx, plant.twist.vy) * np.exp(1j * plant.pose.theta)
    return float(forward.real), float(forward.imag), plant.twist.wz


@every
def test_reflected_inertia_is_what_a_small_torque_at_one_joint_feels(subject: Subject) -> None:
    for joint, inertia in enumerate(subject.plant().reflected_inertia):
        plant = subject.frictionless()
        torques = [0.0] * len(plant.angles)
        torques[joint] = 1e-3
        run(plant, 0.01, torques)
        assert plant.rates[joint] == pytest.approx(1e-3 * 0.01 / inertia, rel=1e-4)


# -- surroundings -----------------------------------------------------------------------------------------------------


@every
def test_a_push_drives_along_world_x_and_a_slope_against_it(subject: Subject) -> None:
    """A slope takes mass times gravity along it, so a push of as much holds the robot where it is."""
    pushed, sliding, held = (subject.frictionless() for _ in range(3))
    force = subject.robot.body.mass * 9.81 * np.sin(0.05)
    pushed.push = held.push = force
    sliding.slope = held.slope = 0.05
    for plant in (pushed, sliding, held):
        run(plant, 0.5)
    assert pushed.pose.x > 0.02
    assert sliding.pose.x == pytest.approx(-pushed.pose.x, rel=1e-6)
    assert held.pose.x == pytest.approx(0.0, abs=1e-9)


@every
def test_wheels_slip_on_ice_and_grip_again(subject: Subject) -> None:
    plant = subject.plant()
    assert all(plant.can_slip(joint) for joint in plant.wheels)
    for joint in plant.wheels:
        plant.set_friction(joint, 0.01)
    run(plant, 0.3, [10.0 * torque for torque in subject.mixed()])
    assert plant.slipping == plant.wheels
    energy = plant.energy
    for joint in plant.wheels:
        plant.set_friction(joint, inf)
    assert plant.slipping == ()
    assert plant.energy < energy
    assert of_the_core(subject, plant) == pytest.approx(plant.rates, abs=1e-9)


@every
def test_what_is_no_wheel_cannot_slip(subject: Subject) -> None:
    plant = subject.plant()
    for joint in set(range(len(plant.angles))) - set(plant.wheels):
        assert not plant.can_slip(joint)
        with pytest.raises(ValueError, match=f"joint {joint}"):
            plant.set_friction(joint, 0.1)


@every
def test_mass_is_what_a_load_adds_and_none_is_the_robot_file(subject: Subject) -> None:
    """Ten times the mass: put on in motion it takes speed and energy, taken off it leaves the speed."""
    gained: list[float] = []
    plant = subject.frictionless()
    for mass in (None, 10.0 * subject.robot.body.mass, None):
        plant.set_mass(mass)
        before = plant.twist.vx
        plant.push = 50.0
        run(plant, 0.05)
        gained.append(plant.twist.vx - before)
        plant.push = 0.0
    assert gained[0] > 4.0 * gained[1] > 0.0
    assert gained[2] == pytest.approx(gained[0], rel=0.01)
    twist, energy = plant.twist, plant.energy
    plant.set_mass(10.0 * subject.robot.body.mass)
    assert 0.0 < plant.twist.vx < twist.vx
    assert plant.energy < energy
    slow = plant.twist
    plant.set_mass(None)
    assert plant.twist == slow


@every
def test_the_reflected_inertia_a_controller_was_tuned_to_does_not_change_with_a_load(subject: Subject) -> None:
    plant = subject.plant()
    before = plant.reflected_inertia
    plant.set_mass(500.0)
    assert plant.reflected_inertia == before


# -- behind the controllers -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "plant"), [key.split("-") for key in SUBJECTS])
def test_the_simulated_controllers_drive_the_plant_they_are_given(name: str, plant: str) -> None:
    """On a load of 1000 kg the same torques, limited as they are, move the robot less."""
    config = load(ROBOTS / f"{name}.toml")[0]
    light, heavy = (plant_of(config.robot, PlantName(plant)) for _ in range(2))
    heavy.set_mass(1000.0)
    ways = []
    for one in (light, heavy):
        loop = ClosedLoop(config, plant=one)
        for index in range(375):
            twist = Twist(0.5, 0.0, 0.0) if index >= 250 else ZERO_TWIST
            due = index % 5 == 0 and index >= 75
            command = TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns)
            loop.cycle(commands=[command] if due else [])
        ways.append(loop.bus.robot.truth.pose.x)
    assert heavy.pose.x == ways[1]
    assert 0.001 < ways[1] < 0.9 * ways[0]


def test_a_load_is_over_the_middle_of_halves_that_slide() -> None:
    """What slides is the robot's own mass, whatever it carries; else close pairs would turn without inertia."""
    plant = PLANTS["odd"][PlantName.SIMPLE](load(ROBOTS / "odd.toml")[0].robot)
    assert isinstance(plant, WithSlides)
    plant.set_mass(500.0)
    run(plant, 4.0, (-0.3, 0.3, 0.3, -0.3))  # together
    assert plant.width < 0.3
    run(plant, 0.5, (-1.0, -1.0, 1.0, 1.0))
    assert plant.energy > 0.0
    assert 0.0 < plant.twist.wz < 5.0
