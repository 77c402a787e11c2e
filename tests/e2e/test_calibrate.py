"""`drivegate calibrate slip` against a running, simulated robot, with a person on a terminal and without."""

import json
import os
import pty
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from gateway.calibration import Plans
from gateway.config import load, parse
from gateway.control.launch import FRICTION
from gateway.core.settings import SPEED_OVERRIDE
from tests.e2e.robot_process import RobotProcess, faster_than, standing
from tests.gateway.test_calibration import gripping
from tests.world import robot_text

FLOOR = 0.5
NAME = "omni4"


def command(robot: RobotProcess, file: Path) -> list[str]:
    said = [*(sys.executable, "-m", "gateway", "calibrate", "slip", str(file)), *("--surface", "a smooth\nfloor")]
    return [*said, *("--rounds", "1", "--json", "--connect", robot.endpoint)]


def answered(
    robot: RobotProcess, file: Path, answer: str, *, interrupted: bool = False
) -> tuple[int, dict[str, object]]:
    """Exit code and document, of a call whose standard input is a terminal. `interrupted`: while the robot moves."""
    person, terminal = pty.openpty()
    heeding = ["env", "--default-signal=INT"]  # what a shell starts in the background ignores Ctrl-C
    said = [*heeding, *command(robot, file)]
    with subprocess.Popen(said, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as call:
        os.write(person, f"{answer}\n".encode())
        if interrupted:
            robot.await_state(faster_than(0.1), timeout=60.0)
            call.send_signal(signal.SIGINT)
        told, _ = call.communicate(timeout=180)
    os.close(terminal)
    os.close(person)
    return call.returncode, json.loads(told.splitlines()[-1])


def await_setting(robot: RobotProcess, name: str, value: float) -> None:
    """States come ten times a second: one that is older says what was set before."""
    robot.await_state(lambda state: (name, value) in [(one.name, one.value) for one in state.status.settings])


def here(robot: RobotProcess) -> tuple[float, float]:
    robot.await_state(standing)
    odometry = robot.client.odometry()
    assert odometry is not None
    return odometry.x, odometry.y


def test_slip(tmp_path: Path, free_port: int) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(gripping(robot_text(NAME)))
    before = file.read_text()
    with RobotProcess(NAME, tmp_path, free_port, "--simulate", "--friction", str(FLOOR), file=file) as robot:
        alone = subprocess.run(
            command(robot, file), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, check=False
        )
        assert alone.returncode == 1
        assert "a person has to let it move" in json.loads(alone.stdout.splitlines()[-1])["reason"]
        code, document = answered(robot, file, "no")
        assert (code, document) == (1, {"ok": False, "reason": "nobody let it move"})
        assert here(robot) == (0.0, 0.0)
        assert file.read_text() == before
        assert robot.client.set(SPEED_OVERRIDE.name, 0.5).ok
        code, document = answered(robot, file, "yes")
        assert (code, document) == (1, {"ok": False, "reason": "speed_override = 0.5: must be 1 for it"})
        assert here(robot) == (0.0, 0.0)
        await_setting(robot, FRICTION, 0.8)
        assert robot.client.set(SPEED_OVERRIDE.name, 1.0).ok
        code, document = answered(robot, file, "yes", interrupted=True)
        assert (code, document) == (1, {"ok": False, "reason": "interrupted"})
        began = here(robot)  # an interrupted launch ends where it comes to rest
        await_setting(robot, FRICTION, 0.8)
        assert file.read_text() == before
        code, document = answered(robot, file, "yes")
        assert (code, document["ok"]) == (0, True), document
        furthest = Plans(load(file)[0]).furthest()
        assert all(abs(now - then) < furthest for now, then in zip(here(robot), began, strict=True))
        await_setting(robot, FRICTION, 0.8)  # what was found counts from the next start on
        robot.end()
        assert robot.verify().identical
    text = file.read_text()
    grip = tomllib.loads(text)["robot"]["grip"]
    assert grip == {"friction": document["friction"]}
    # The least of what launches found, on a clock that may be late; tests.gateway.test_calibration has it exact.
    assert 0.75 * FLOOR < grip["friction"] < 1.01 * FLOOR
    assert " # a smooth floor, 20" in text
    assert [line for line in text.splitlines() if "friction = " not in line] == [
        line for line in before.splitlines() if "friction = " not in line
    ]
    parse(text, NAME)
    wheels = document["wheels"]
    assert isinstance(wheels, list)
    assert len(wheels) == 4
    for wheel in wheels:  # 25 kg on four wheels of 76.2 mm
        assert wheel["load"] * 4 == pytest.approx(25 * 9.81)
        assert wheel["torque"] == pytest.approx(grip["friction"] * wheel["load"] * 0.0762)
        assert wheel["voltage"] is None
