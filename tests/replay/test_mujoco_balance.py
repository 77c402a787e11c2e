"""A robot that balances through the service's core on MuJoCo's plant, which knows nothing of how it is kept upright."""

from math import degrees, radians

import pytest

from gateway.chassis.odd import OddRobot
from gateway.types import ZERO_TWIST, Mode, RequestKind, Twist
from replay.sim.plants.odd_bodies import Leaning
from tests.replay.mujoco_odd import MujocoOdd
from tests.upright import Upright


def on_mujoco(robot: OddRobot) -> MujocoOdd:
    assert robot.balance is not None
    return MujocoOdd(robot, Leaning(robot.balance.height, robot.balance.pitch_inertia))


def standing() -> Upright:
    robot = Upright(can=True, moved_by=on_mujoco)
    robot.run(0.1, ZERO_TWIST)
    assert robot.ask(RequestKind.STAND_UP, ZERO_TWIST).ok
    robot.run(1.5, ZERO_TWIST)
    assert robot.is_in(Mode.DRIVE)
    return robot


@pytest.mark.parametrize("lean", [5.0, -5.0])
def test_a_push_of_five_degrees_is_over_within_a_second_and_a_half(lean: float) -> None:
    robot = standing()
    robot.plant.lean(radians(lean))
    leaning = []
    for _ in range(3 * 250):
        robot.cycle(ZERO_TWIST)
        leaning.append(abs(degrees(robot.plant.pitch)))
    last = max(index for index, pitch in enumerate(leaning) if pitch >= 0.5)
    assert last / 250.0 < 1.5


def test_it_drives_turns_and_comes_to_rest() -> None:
    robot = standing()
    robot.run(3.0, Twist(0.8, 0.0, 0.0))
    assert robot.plant.twist.vx == pytest.approx(0.8, abs=0.06)
    robot.run(2.0, Twist(0.0, 0.0, 1.0))
    assert robot.plant.twist.wz == pytest.approx(1.0, abs=0.05)
    robot.run(4.0)
    assert robot.is_in(Mode.STOPPING)
    assert max(map(abs, robot.plant.twist)) < 0.1
    assert abs(robot.plant.pitch) < 0.02
