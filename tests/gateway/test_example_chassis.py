"""The chassis that the documentation adds: driven as a whole robot, and held against wheels at the same places."""

import tomllib
from math import cos, pi, sin
from typing import Annotated, cast

import pytest
from pydantic import Field

from gateway.chassis import AnyRobot
from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.config import RobotConfig
from gateway.types import Mode, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.plants import PLANTS
from replay.sim.plants.contract import PlantName
from tests.gateway.example_chassis import ANGLES, KiwiRobot, plant
from tests.setup_robots import kiwi

MOTION = Twist(0.3, 0.2, 0.5)


class WithKiwi(RobotConfig):
    """What the line in the registry of chassis does."""

    robot: Annotated[AnyRobot | KiwiRobot, Field(discriminator="kind")]  # type: ignore[assignment]


@pytest.fixture
def config(monkeypatch: pytest.MonkeyPatch) -> RobotConfig:
    """The kiwi of the setup, in the words of the new chassis."""
    monkeypatch.setitem(PLANTS, "kiwi", {PlantName.SIMPLE: plant})
    document = tomllib.loads(kiwi())
    body = document["robot"]["body"]
    wheels = ["front", "rear_left", "rear_right"]
    document["robot"] = {"kind": "kiwi", "name": "kiwi", "reach": 0.15, "radius": 0.05, "wheels": wheels, "body": body}
    return WithKiwi.model_validate(document)


def test_its_wheels_are_where_they_should_be(config: RobotConfig) -> None:
    poses = [WheelPose(0.15 * cos(a), 0.15 * sin(a), a, 0.05) for a in ANGLES]
    moves = config.robot.kinematics()
    speeds = moves.wheel_speeds(MOTION, ())
    assert speeds == pytest.approx(omni_kinematics(poses).wheel_speeds(MOTION), abs=1e-12)
    assert moves.motion(cast(list[float], speeds), ()) == pytest.approx(MOTION, abs=1e-12)
    assert [wheel.rolling for wheel in config.robot.drawing().wheels] == [angle + pi / 2 for angle in ANGLES]


def test_it_drives(config: RobotConfig) -> None:
    loop = ClosedLoop(config)

    def command(twist: Twist, seconds: float) -> Mode:
        for _ in range(round(seconds * 1e9 / loop.period_ns)):
            told = TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns)
            _, outputs = loop.cycle(commands=[told])
        return outputs.mode

    assert command(Twist(0.0, 0.0, 0.0), 4.0) is Mode.DRIVE
    assert command(MOTION, 2.0) is Mode.DRIVE
    assert loop.bus.robot.truth.twist == pytest.approx(MOTION, abs=0.02)
