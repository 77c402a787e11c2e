"""How soon each fault ends the drive, and how far the robot gets until then; in virtual time, with a margin."""

from itertools import pairwise
from math import hypot
from typing import NamedTuple

import pytest

from gateway.types import Mode
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario

AT = 3.0  # s; when it breaks, at a steady speed


class Row(NamedTuple):
    """`speed`: m/s ahead, or rad/s of turning for the platform; then at most so long (s) and so far (m) in DRIVE."""

    robot: str
    kind: str
    motor: str
    speed: float
    time: float
    way: float


ROWS = [
    Row("moby", "encoder_frozen", "left", 0.2, 0.020, 0.005),
    Row("moby", "encoder_frozen", "left", 0.5, 0.020, 0.011),
    Row("moby", "encoder_frozen", "left", 1.0, 0.020, 0.021),
    Row("moby", "encoder_frozen", "platform", 0.8, 0.020, 0.001),
    Row("moby", "torque_inverted", "left", 0.2, 0.140, 0.030),
    Row("moby", "torque_inverted", "left", 0.5, 0.180, 0.080),
    Row("moby", "torque_inverted", "left", 1.0, 0.270, 0.230),
    Row("moby", "push", "left", 0.1, 0.600, 0.010),
    Row("omni4", "encoder_frozen", "front_left", 0.2, 0.020, 0.005),
    Row("omni4", "encoder_frozen", "front_left", 0.5, 0.020, 0.011),
    Row("omni4", "encoder_frozen", "front_left", 1.0, 0.020, 0.021),
    Row("omni4", "push", "front_left", 0.1, 0.900, 0.010),
]
PUSH = {"moby": -1510.0, "omni4": -206.0}  # N; more than all motors together bear


def scenario(row: Row) -> Scenario:
    turning = row.motor == "platform"
    twist = {"vx": 0.0 if turning else row.speed, "vy": 0.0, "wz": row.speed if turning else 0.0}
    pushed = {"kind": "push", "value": PUSH[row.robot], "seconds": 10.0}
    fault = pushed if row.kind == "push" else {"kind": row.kind, "motor": row.motor}
    rest = {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}
    at = [{"t": 0.2, "command": rest}, {"t": 1.0, "command": {"source": "teleop", **twist}}, {"t": AT, "fault": fault}]
    return Scenario.model_validate({"robot": row.robot, "seconds": AT + 1.5, "at": at})


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.robot}-{row.kind}-{row.motor}-{row.speed}")
def test_ends_in_time_and_blames_the_right_motor(row: Row) -> None:
    moments: list[Moment] = []
    result = run_scenario(scenario(row), watch=moments.append)
    broken = [moment for moment in moments if moment.t >= AT]
    assert broken[0].outputs.mode is Mode.DRIVE
    end = next(place for place, moment in enumerate(broken) if moment.outputs.mode is not Mode.DRIVE)
    poses = [moment.truth.pose for moment in broken[: end + 1]]
    way = sum(hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(poses))
    assert broken[end].t - AT <= row.time
    assert way <= row.way
    faults = [event for _, event in result.events if event.code.startswith("fault_")]
    assert faults[0].text.startswith(f"{row.motor}: ")
