"""A whole robot on VESCs behind the real core: it drives, and breaks, as the same robot on other controllers does."""

from math import cos, pi, sin
from typing import Any

import pytest

from gateway.types import ZERO_TWIST, Mode, Twist
from replay.drive.scenario import Result, run_scenario
from replay.drive.scenario_file import Scenario, load_scenario
from replay.sim.controllers.vesc import SimulatedVesc
from tests.world import ROBOTS, World

ON_VESC = "omni4_vesc"


def vescs(world: World) -> list[SimulatedVesc]:
    devices = [device for device in world.bus.robot.devices.values() if isinstance(device, SimulatedVesc)]
    assert len(devices) == 4
    return devices


@pytest.fixture
def world() -> World:
    return World(ON_VESC)


def test_it_drives_in_eight_directions_and_comes_to_rest(world: World) -> None:
    world.start()
    for eighth in range(8):
        wanted = Twist(0.5 * cos(eighth * pi / 4), 0.5 * sin(eighth * pi / 4), 0.5)
        world.run(1.2, wanted)
        assert world.bus.robot.truth.twist == pytest.approx(wanted, abs=0.005)
        assert world.last.trace.measured == pytest.approx(wanted, abs=0.005)
    world.run(3.0, ZERO_TWIST)
    assert world.true_speed() < 1e-3
    world.run(1.0)
    assert world.is_in(Mode.IDLE)
    assert not {event.code for event in world.events} - {"mode_starting", "mode_drive", "mode_stopping", "mode_idle"}


def test_odometry_is_as_good_as_the_counts(world: World) -> None:
    """504 counts per turn of a wheel are 1 mm of its rim."""
    world.start()
    world.run(4.0, Twist(0.4, 0.2, 0.3))
    world.run(3.0, ZERO_TWIST)
    assert world.last.trace.pose[:2] == pytest.approx(world.bus.robot.truth.pose[:2], abs=0.002)


def test_at_rest_in_drive_it_is_braked_and_in_idle_released(world: World) -> None:
    world.start()
    world.run(0.5, ZERO_TWIST)
    assert {frame.id >> 8 for frame in world.last.frames} <= {0, 8}
    world.run(2.0)
    assert world.is_in(Mode.IDLE)
    for frame in world.last.frames:
        assert frame.id >> 8 == 8 or (frame.id >> 8, frame.data) == (1, bytes(4))


@pytest.mark.parametrize("timeout", [0.0, 1.0])
def test_a_command_timeout_that_is_not_the_one_of_the_robot_file_is_found_before_it_drives(
    world: World, timeout: float
) -> None:
    vescs(world)[2].timeout_s = timeout
    world.run(0.3)
    world.run(4.0, ZERO_TWIST)
    assert not {mode for _, outputs in world.records if (mode := outputs.mode) in {Mode.DRIVE, Mode.DEGRADED}}
    texts = [event.text for event in world.events if event.code == "fault_motor"]
    assert any(text.startswith("rear_right: its command timeout has not expired") for text in texts)


def test_a_fault_of_a_vesc_is_latched_though_it_forgets_it_itself(world: World) -> None:
    world.start()
    world.run(2.0, Twist(0.5, 0.0, 0.0))
    vescs(world)[1].raise_fault(4)
    world.run(2.0, Twist(0.5, 0.0, 0.0))
    assert world.is_in(Mode.DEGRADED)
    (text,) = [event.text for event in world.events if event.code == "fault_motor"]
    assert text == "rear_left: fault 4, ABS_OVER_CURRENT"
    assert world.bus.robot.truth.twist == pytest.approx((0.5, 0.0, 0.0), abs=0.01), "three wheels drive on"


def test_a_host_that_dies_leaves_released_motors(world: World) -> None:
    world.start()
    world.run(2.0, Twist(0.5, 0.0, 0.0))
    world.bus.advance(world.now_ns + 150_000_000)
    assert world.bus.robot.truth.joint_torques == (0.0,) * 4


def test_one_that_dies_with_a_brake_current_set_leaves_braked_ones(world: World) -> None:
    for device in vescs(world):
        device.timeout_brake_current = 10.0
    world.start()
    world.run(2.0, Twist(0.5, 0.0, 0.0))
    world.bus.advance(world.now_ns + 1_000_000_000)
    assert world.true_speed() < 0.01


# -- the same ends as with other controllers --------------------------------------------------------------------------

DRIVE: list[dict[str, Any]] = [
    {"t": 0.5, "command": {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}},
    {"t": 1.0, "command": {"source": "teleop", "vx": 1.0, "vy": 0.0, "wz": 0.0}},
    {"t": 3.0, "silence": "teleop"},
]
LOST = {"kind": "power_off", "motor": "rear_left"}


def driven(robot: str, fault: dict[str, Any]) -> Result:
    at = sorted([*DRIVE, {"t": 2.5, "fault": fault}], key=lambda entry: entry["t"])
    return run_scenario(Scenario.model_validate({"robot": robot, "seconds": 6.0, "at": at}))


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (LOST, "fault_silent"),
        (LOST | {"kind": "cable_out"}, "fault_silent"),
        (LOST | {"kind": "power_cycle", "seconds": 0.3}, "fault_silent"),
        (LOST | {"kind": "encoder_frozen"}, "fault_frozen"),
        (LOST | {"kind": "torque_inverted"}, "fault_reversed"),
        (LOST | {"kind": "id_twin"}, "fault_twin"),
        ({"kind": "bus_down", "seconds": 0.5}, "fault_bus"),
        ({"kind": "frames_lost", "value": 0.3, "seconds": 1.0}, None),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else "",
)
def test_faults_end_as_on_the_other_controllers(fault: dict[str, Any], code: str | None) -> None:
    ours, theirs = driven(ON_VESC, fault), driven("omni4", fault)
    for one in (ours, theirs):
        assert {event.code for _, event in one.events if event.code.startswith("fault_")} == {code} - {None}
    # The frozen wheel and its likes are a fault once the robot is in idle; before it, all is as in the other.
    assert [mode for _, mode in ours.modes] == [mode for _, mode in theirs.modes]
    assert ours.max_true_speed == pytest.approx(theirs.max_true_speed, abs=0.05)
    if fault["kind"] != "cable_out":  # a C620 holds its last current
        assert ours.true_distance == pytest.approx(theirs.true_distance, abs=0.15)


@pytest.mark.parametrize("name", ["frozen_encoder", "emergency_stop"])
def test_scenarios_end_as_they_must(name: str) -> None:
    script = load_scenario(ROBOTS.parent / "scenarios" / f"{name}.toml")
    assert run_scenario(script.model_copy(update={"robot": ON_VESC})).broken == ()


def test_a_loop_that_stood_still_for_longer_than_the_command_timeout_starts_anew() -> None:
    result = driven(ON_VESC, {"kind": "loop_pause", "seconds": 0.15})
    assert [mode for _, mode in result.modes][-1] is Mode.FAULT, "released, it rolls on"
    shorter = driven(ON_VESC, {"kind": "loop_pause", "seconds": 0.08})
    assert Mode.FAULT not in {mode for _, mode in shorter.modes}
