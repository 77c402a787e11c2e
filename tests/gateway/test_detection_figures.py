"""How soon each fault ends the drive, and how far the robot gets until then; in virtual time, with a margin."""

from itertools import pairwise
from math import hypot
from typing import Any, NamedTuple

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
    Row("omni4", "torque_inverted", "front_left", 0.2, 0.160, 0.030),
    Row("omni4", "torque_inverted", "front_left", 0.5, 0.150, 0.070),
    Row("omni4", "torque_inverted", "front_left", 1.0, 0.135, 0.130),
    Row("omni4", "torque_inverted", "rear_right", 0.5, 0.140, 0.070),
    Row("omni4", "torque_inverted", "rear_right", 1.0, 0.125, 0.120),
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


@pytest.mark.parametrize("row", [row for row in ROWS if row.kind == "torque_inverted"], ids=str)
def test_a_wrong_sign_is_blamed_on_nobody_else(row: Row) -> None:
    result = run_scenario(scenario(row))
    faults = {event.text.partition(":")[0] for _, event in result.events if event.code.startswith("fault_")}
    assert faults == {row.motor}


OVERLOADS: dict[str, list[dict[str, Any]]] = {
    "pushed": [{"t": 2.0, "fault": {"kind": "push", "value": -206.0, "seconds": 0.5}}],
    "uphill": [{"t": 0.0, "fault": {"kind": "slope", "value": 0.3}}],
    "loaded": [{"t": 0.0, "fault": {"kind": "mass", "value": 150.0}}],
    "one wheel on ice": [
        {"t": 0.0, "fault": {"kind": "friction", "motor": "front_left", "value": 0.05}},
        {"t": 1.6, "fault": {"kind": "friction", "motor": "front_left", "value": 0.9}},
    ],
    "stopped hard": [{"t": 2.4, "request": "estop"}],
}


@pytest.mark.parametrize("overload", OVERLOADS)
@pytest.mark.parametrize("twist", [(1.0, 0.0, 0.0), (0.0, 0.0, 3.0), (1.0, 0.5, 1.0), (0.0, -0.8, 0.0)])
def test_a_hard_drive_is_no_wrong_sign(overload: str, twist: tuple[float, float, float]) -> None:
    vx, vy, wz = twist
    rest = {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}
    there, back = rest | {"vx": vx, "vy": vy, "wz": wz}, rest | {"vx": -vx, "vy": -vy, "wz": -wz}
    at = [{"t": 0.2, "command": rest}, {"t": 0.6, "command": there}, {"t": 2.5, "command": back}]
    result = run_scenario(Scenario.model_validate({"robot": "omni4", "seconds": 4.0, "at": at + OVERLOADS[overload]}))
    assert "fault_reversed" not in {event.code for _, event in result.events}
