"""A second controller on the id of one motor, in virtual time: both robots, at rest and at speed, say whose id."""

from typing import Any

import pytest

from gateway.types import Mode
from replay.drive.scenario import Result, run_scenario
from replay.drive.scenario_file import Scenario

AT = 2.5  # s
ZERO = {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}
IDS = {"front_left": 1, "rear_right": 3, "left": 1, "right": 2, "platform": 3}
MOTORS = [("omni4", "front_left"), ("omni4", "rear_right"), ("moby", "left"), ("moby", "right"), ("moby", "platform")]


def drive(robot: str, speed: float | None, *faults: dict[str, Any], seconds: float = 3.5) -> Result:
    commands: list[dict[str, Any]] = []
    if speed is not None:
        commands = [{"t": 0.3, "command": ZERO}, {"t": 1.0, "command": ZERO | {"vx": speed}}]
    at = [*commands, *({"t": AT, "fault": fault} for fault in faults)]
    return run_scenario(Scenario.model_validate({"robot": robot, "seconds": seconds, "at": at}))


@pytest.mark.parametrize(("robot", "motor"), MOTORS)
@pytest.mark.parametrize("speed", [None, 0.0, 0.1, 1.0], ids=["idle", "held", "slow", "fast"])
def test_is_named_within_30_ms(robot: str, motor: str, speed: float | None) -> None:
    result = drive(robot, speed, {"kind": "id_twin", "motor": motor, "value": 1.0})
    t, event = next((t, event) for t, event in result.events if event.code.startswith("fault_"))
    assert event.code == "fault_twin"
    assert event.text == f"{motor}: two controllers answer as id {IDS[motor]} on can0"
    assert t - AT <= 0.030
    assert result.modes[-1][1] in {Mode.FAULT, Mode.DEGRADED}


@pytest.mark.parametrize(("robot", "top"), [("omni4", 2.0), ("moby", 1.2)])
@pytest.mark.parametrize("speed", [None, 0.3, 1.0], ids=["idle", "slow", "top"])
@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "frames_lost", "value": 0.5},
        {"kind": "frames_delayed", "value": 0.03, "seconds": 0.2},
        {"kind": "power_cycle"},
        {"kind": "power_cycle", "seconds": 0.3},
        {"kind": "encoder_jump", "value": 1.0},
        {"kind": "loop_pause", "seconds": 0.3},
    ],
    ids=lambda fault: str(fault["kind"]),
)
def test_nothing_else_is_taken_for_one(robot: str, top: float, speed: float | None, fault: dict[str, Any]) -> None:
    result = drive(robot, None if speed is None else speed * top, fault, seconds=4.0)
    assert "fault_twin" not in {event.code for _, event in result.events}
