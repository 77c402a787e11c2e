"""omni4 on its dynamics through the whole service: command, engine, CAN frames, simulated C620, wheels on a floor."""

from math import hypot
from random import Random
from typing import Any

import pytest

from gateway.types import Level, Mode
from replay.drive.moment import Moment
from replay.drive.scenario import Result, run_scenario
from replay.drive.scenario_file import Scenario

FLOOR = 0.8


def command(t: float, vx: float, vy: float, wz: float) -> dict[str, Any]:
    return {"t": t, "command": {"source": "teleop", "vx": vx, "vy": vy, "wz": wz}}


def drive(seconds: float, *at: dict[str, Any], friction: float | None = FLOOR) -> tuple[Result, list[Moment]]:
    """From a zero command on, on a floor with this friction (None: one that always holds)."""
    floor = [] if friction is None else [{"t": 0.0, "fault": {"kind": "friction", "value": friction}}]
    document = {
        "robot": "omni4",
        "seconds": seconds,
        "plant": "dynamics",
        "at": [*floor, command(0.3, 0.0, 0.0, 0.0), *at],
    }
    seen: list[Moment] = []
    return run_scenario(Scenario.model_validate(document), watch=seen.append), seen


def alarms(result: Result) -> list[str]:
    return [event.code for _, event in result.events if event.level is not Level.INFO]


@pytest.mark.parametrize("seed", range(2))
def test_a_healthy_drive_shows_no_fault(seed: int) -> None:
    """Half a minute of commands over the whole range of what the robot can, each held for 0.5 to 2 s."""
    random, t, at = Random(seed), 1.0, []
    while t < 28.0:
        at.append(command(t, random.uniform(-2.0, 2.0), random.uniform(-1.5, 1.5), random.uniform(-4.0, 4.0)))
        t += random.uniform(0.5, 2.0)
    result, seen = drive(32.0, *at, command(28.0, 0.0, 0.0, 0.0), friction=None)
    assert alarms(result) == []
    assert {mode for _, mode in result.modes} == {Mode.IDLE, Mode.STARTING, Mode.DRIVE}
    assert result.true_distance > 10.0
    assert seen[-1].truth.twist == pytest.approx((0.0, 0.0, 0.0), abs=0.01)


def test_forward_and_to_rest_on_a_floor_that_holds_enough() -> None:
    """Within the limits of the robot file a floor of 0.8 lets no wheel slip: the way is that of the odometry."""
    result, seen = drive(6.0, command(1.0, 1.5, 0.0, 0.0), command(3.5, 0.0, 0.0, 0.0))
    assert alarms(result) == []
    truth = seen[-1].truth.pose
    assert truth.x > 2.5
    pose = seen[-1].outputs.trace.pose
    assert hypot(truth.x - pose.x, truth.y - pose.y) < 0.01


def test_on_a_slippery_floor_the_same_command_leaves_the_wheels_behind() -> None:
    """mu 0.05 gives less than a quarter of what is asked: the robot is slower than its odometry says."""
    _, good = drive(2.0, command(1.0, 1.5, 0.0, 0.0))
    _, poor = drive(2.0, command(1.0, 1.5, 0.0, 0.0), friction=0.05)
    assert poor[-1].truth.twist.vx < 0.6 * good[-1].truth.twist.vx
    assert poor[-1].truth.twist.vx < 0.05 * 9.81 * 1.05
