"""Small parts of the core: reporter, speed loop, transmission, sd_notify."""

import os
import socket
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.control.speed_loop import SpeedLoop
from gateway.control.transmission import Transmission, Winding
from gateway.core.reporter import Due
from gateway.edges.systemd import Notifier


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=60))
def test_the_speed_loop_never_exceeds_its_torque(samples: list[tuple[float, float]]) -> None:
    loop = SpeedLoop(kp=2.0, ki=4.0, max_torque=4.5)
    assert all(abs(loop.torque(setpoint, speed, 0.004)) <= 4.5 for setpoint, speed in samples)


def test_the_speed_loop_does_not_wind_up() -> None:
    """Blocked at full torque for ten seconds, it lets go within a few cycles of the setpoint's return."""
    loop = SpeedLoop(kp=2.0, ki=4.0, max_torque=4.5)
    for _ in range(2500):
        assert loop.torque(10.0, 0.0, 0.004) == 4.5
    assert loop.torque(0.0, 0.0, 0.004) < 4.5


def test_the_speed_loop_does_not_drive_a_wheel_whose_speed_is_unknown() -> None:
    """Nor does it go on afterwards from what it had summed up: kp 2 and ki 4 of an error of 1 in 4 ms are 2.016."""
    loop = SpeedLoop(kp=2.0, ki=4.0, max_torque=4.5)
    for _ in range(100):
        loop.torque(1.0, 0.0, 0.004)
    assert loop.torque(1.0, None, 0.004) == 0.0
    assert loop.torque(1.0, 0.0, 0.004) == pytest.approx(2.016)


def swung(loop: SpeedLoop, inertia: float, *, cycles: int, start: float = 5.0, drag: float = 0.0) -> list[float]:
    """Speeds of a wheel that is told to stand; `drag`: N m of dry friction."""
    speed, speeds = start, []
    for _ in range(cycles):
        speed += loop.torque(0.0, speed, 0.004) * 0.004 / inertia
        slowed = min(abs(speed), drag * 0.004 / inertia)
        speed -= slowed if speed > 0.0 else -slowed
        speeds.append(speed)
    return speeds


def test_a_wheel_that_is_too_light_for_its_gain_comes_to_rest_all_the_same() -> None:
    """One that slips: in each cycle the gain takes back 3.5 times its error."""
    loop = SpeedLoop(kp=3.5, ki=14.0, max_torque=4.5)
    speeds = swung(loop, 0.004, cycles=500, drag=0.09)
    assert max(map(abs, speeds[100:])) < 0.05
    assert loop.torque(0.0, 1.0, 0.004) == pytest.approx(-3.5, abs=0.2), "where it no longer swings the gain is back"
    loose = SpeedLoop(kp=3.5, ki=14.0, max_torque=4.5)
    assert max(map(abs, swung(loose, 0.004, cycles=2500)[50:])) < 0.6, "nothing resists it: 2.2 with all of the gain"
    loose.reset()
    assert loose.torque(0.0, 1.0, 0.004) == pytest.approx(-3.5 - 14.0 * 0.004)


def test_a_loop_that_takes_back_no_more_than_all_of_an_error_keeps_its_gain() -> None:
    loop = SpeedLoop(kp=3.5, ki=0.0, max_torque=4.5)
    speeds = swung(loop, 0.0141, cycles=100, start=1.0)
    for before, after in zip([1.0, *speeds], speeds, strict=False):
        assert after == pytest.approx(before * (1.0 - 3.5 * 0.004 / 0.0141), abs=1e-12)


def test_transmission_applies_ratio_sign_and_zero_once() -> None:
    gear = Transmission(ratio=-50.0, zero=0.5)
    assert gear.motor_speed(2.0) == -100.0
    assert gear.motor_torque(75.0) == -1.5
    assert gear.output(-100.0, -75.0) == (2.0, 1.0)
    assert gear.output(None, None) == (None, None)
    assert gear.output_torque(-1.5) == 75.0


def test_a_winding_has_one_constant_for_torque_and_back_emf() -> None:
    winding = Winding(resistance=2.0, back_emf=0.5)
    assert winding.voltage(0.0, 0.0) == 0.0
    assert winding.voltage(1.0, 0.0) == 4.0, "2 A through 2 ohm"
    assert winding.voltage(0.0, 10.0) == 5.0, "no current"
    assert winding.voltage(-1.0, 10.0) == 1.0


def test_due_keeps_its_rate_and_does_not_burst() -> None:
    due = Due(10.0)
    period = 100_000_000
    assert [due(now) for now in (0, 1, period - 1, period, 5 * period + 1, 5 * period + 2, 6 * period)] == [
        True,
        False,
        False,
        True,
        True,
        False,
        True,
    ]


def test_systemd_is_told_and_its_variables_do_not_leak(tmp_path: Path) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(path))
        manager.settimeout(5.0)
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())}
        notifier = Notifier(environment)
        assert environment == {}
        notifier.ready("idle")
        assert manager.recv(100) == b"READY=1\nSTATUS=idle"
        second = 1_000_000_000
        for now_ns in (2 * second, 2 * second + 1, 3 * second):
            notifier.feed_watchdog(now_ns)
        notifier.stopping()
        assert [manager.recv(100) for _ in range(3)] == [b"WATCHDOG=1", b"WATCHDOG=1", b"STOPPING=1"]
        notifier.close()


def test_without_systemd_nothing_happens() -> None:
    notifier = Notifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"})
    notifier.ready("idle")
    notifier.feed_watchdog(1)


def test_a_service_manager_that_is_gone_does_not_stop_the_robot(tmp_path: Path) -> None:
    path = tmp_path / "notify"
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(path))
    notifier = Notifier({"NOTIFY_SOCKET": str(path)})
    manager.close()
    notifier.status("still here")
    notifier.close()
