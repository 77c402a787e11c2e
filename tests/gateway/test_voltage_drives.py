"""A robot whose motors take only voltages: it drives, stops and finds its faults as one whose motors take torques."""

from math import hypot

import pytest

from gateway.types import ZERO_TWIST, Mode, RequestKind, Twist
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from tests.world import World

ROBOT = "omni4_gm6020"
WHEELS = ("front_left", "rear_left", "rear_right", "front_right")


def driving(twist: Twist) -> tuple[World, float]:
    """Driven so for two seconds, and its highest true speed on the way, m/s."""
    world, peak = World(ROBOT), 0.0
    world.start()
    for _ in range(100):
        world.run(0.02, twist)
        peak = max(peak, hypot(*world.bus.robot.truth.twist[:2]))
    return world, peak


@pytest.mark.parametrize(
    "twist",
    [Twist(1.0, 0.0, 0.0), Twist(0.0, -1.0, 0.0), Twist(0.6, 0.6, 0.5), Twist(0.0, 0.0, 3.0), Twist(0.05, 0.0, 0.0)],
)
def test_it_drives_as_it_is_told_and_comes_to_rest(twist: Twist) -> None:
    """A speed told in whole rpm is up to 0.1 rad/s off, which is 7.5 mm/s of the body or 0.03 rad/s of its turning."""
    world, peak = driving(twist)
    assert world.is_in(Mode.DRIVE)
    for true, wanted, off in zip(world.bus.robot.truth.twist, twist, (0.009, 0.009, 0.03), strict=True):
        assert true == pytest.approx(wanted, abs=off)
    assert peak < hypot(twist.vx, twist.vy) + 0.03
    status = world.last.status
    assert status is None or [motor.torque for motor in status.motors] == [None] * 4, "nobody measures it"
    world.run(3.0, ZERO_TWIST)
    assert world.true_speed() < 0.01
    assert not [event for event in world.events if "fault" in event.code or event.code == "slip"]


def test_released_it_is_braked_by_its_windings_and_an_emergency_stop_brakes_harder() -> None:
    """The floor's drag is 0.05 N m a wheel; shorted windings brake with 0.06 N m per rad/s, and 1.2 N m is allowed."""
    stopped, _ = driving(Twist(1.0, 0.0, 0.0))
    stopped.request(RequestKind.ESTOP)
    stopped.run(0.35)
    assert stopped.true_speed() < 0.02
    rolling, _ = driving(Twist(1.0, 0.0, 0.0))
    for name in WHEELS:
        rolling.bus.robot.devices[name].receive(rolling.engine.coast_frames()[0], rolling.now_ns)
        rolling.bus.robot.devices[name].unplug()
    rolling.run(0.35)
    assert 0.02 < rolling.true_speed() < 0.3


def faults(
    kind: str, *, vx: float = 0.8, motor: str | None = "front_left", **more: float
) -> list[tuple[str, float, tuple[str, ...]]]:
    """What is found within 1.5 s: code, seconds since it happened, and which motors are named."""
    fault = {"kind": kind} | more | ({"motor": motor} if motor else {})
    at = [
        {"t": 0.2, "command": {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}},
        {"t": 1.0, "command": {"source": "teleop", "vx": vx, "vy": 0.0, "wz": 0.0}},
        {"t": 3.0, "fault": fault},
    ]
    result = run_scenario(Scenario.model_validate({"robot": ROBOT, "seconds": 4.5, "at": at}))
    return [
        (event.code, t - 3.0, tuple(name for name in WHEELS if name in event.text))
        for t, event in result.events
        if t > 2.0
    ]


@pytest.mark.parametrize(
    ("kind", "vx", "code", "seconds"),
    [
        ("power_off", 0.8, "fault_silent", 0.06),
        ("cable_out", 0.8, "fault_silent", 0.06),
        ("encoder_frozen", 0.8, "fault_frozen", 0.02),
        ("encoder_frozen", 0.2, "fault_frozen", 0.02),
        (
            "torque_inverted",
            0.8,
            "fault_reversed",
            0.17,
        ),  # by what it was told to give; without that it takes 0.7 s, ...
        ("torque_inverted", 0.3, "fault_reversed", 0.17),  # ... and by then the others seem to run away
        ("id_twin", 0.8, "fault_twin", 0.01),
    ],
)
def test_faults_are_found_without_a_measured_torque_and_only_in_the_motor_that_has_them(
    kind: str, vx: float, code: str, seconds: float
) -> None:
    (first, when, named), (then, *_) = faults(kind, vx=vx)
    assert (first, named, then) == (code, ("front_left",), "mode_degraded")
    assert when <= seconds


def test_what_all_motors_together_cannot_move_is_a_stall() -> None:
    """Four times 1.2 N m at 45 degrees and 0.0508 m are 66.8 N."""
    found = faults("push", vx=0.3, motor=None, value=-68.0, seconds=1.4)
    assert [code for code, *_ in found] == ["fault_stall"] * 4 + ["mode_fault"]


def test_an_overload_is_no_fault() -> None:
    assert faults("mass", motor=None, value=40.0) == []
    assert faults("slope", motor=None, value=0.1) == []
