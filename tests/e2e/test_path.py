"""`drivegate path` against running, simulated robots: to the end, stopped, interrupted, refused."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.edges.messages import StateMessage
from tests.e2e.robot_process import RobotProcess, standing
from tests.gateway.test_path_drive import PATHS, compensated
from tests.world import robot_text

LINE = "[start]\nx = {x}\n[[piece]]\nkind = 'line'\nlength = 20.0\n"


def command(robot: RobotProcess, file: Path, *arguments: str) -> list[str]:
    return [
        *(sys.executable, "-m", "gateway", "path", str(file), robot.name),
        *(*arguments, "--json", "--connect", robot.endpoint),
    ]


def driven(robot: RobotProcess, file: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(robot, file, *arguments), capture_output=True, text=True, timeout=120, check=False)


def here(robot: RobotProcess) -> float:
    """x of the newest odometry, m."""
    robot.await_state(standing)
    odometry = robot.client.odometry()
    assert odometry is not None
    return odometry.x


def moving(state: StateMessage) -> bool:
    twist = state.status.twist
    return twist is not None and abs(twist.vx) + abs(twist.vy) > 0.2


@pytest.mark.parametrize(
    ("name", "file", "speed", "beside"),
    [("omni4", "omni4_square", "0.8", 0.3), ("moby", "moby_course", "0.6", 0.15)],
)
def test_to_the_end(name: str, file: str, speed: str, beside: float, tmp_path: Path, free_port: int) -> None:  # noqa: PLR0917
    """The robot really stands at the end of the path, and the recording says the same again."""
    text = robot_text(name)
    robot_file = tmp_path / "robot.toml"
    robot_file.write_text(compensated(text) if name == "moby" else text)
    with RobotProcess(name, tmp_path, free_port, file=robot_file) as robot:
        done = driven(robot, PATHS / f"{file}.toml", "--speed", speed)
        assert done.returncode == 0, done.stderr
        result = json.loads(done.stdout.splitlines()[-1])
        assert set(result) == {"ok", "reason", "length", "seconds", "max_deviation", "end_deviation", "mode"}
        assert (result["ok"], result["reason"], result["mode"]) == (True, None, "drive")
        assert result["max_deviation"] < beside
        assert result["end_deviation"] < 0.1
        robot.await_state(standing)
        assert robot.end() == 0
        assert robot.verify().identical


def test_stopped_and_interrupted_and_refused(tmp_path: Path, free_port: int) -> None:
    line = tmp_path / "line.toml"
    with RobotProcess("omni4", tmp_path, free_port) as robot:
        for ending, code, reason in (
            (signal.SIGINT, 130, "interrupted"),
            (None, 1, "mode estop: emergency stop: needs a reset"),
        ):
            line.write_text(LINE.format(x=here(robot)))
            process = subprocess.Popen(
                ["env", "--default-signal=INT", *command(robot, line, "--speed", "0.4")],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            try:
                robot.await_state(moving, timeout=40.0)
                if ending is None:
                    assert robot.client.stop()
                else:
                    process.send_signal(ending)
                out, err = process.communicate(timeout=30.0)
            finally:
                process.kill()
                process.wait(10.0)
            assert process.returncode == code, err
            assert json.loads(out.splitlines()[-1])["reason"] == reason
            assert reason in err
            robot.await_state(standing)
        line.write_text(LINE.format(x=here(robot)))
        latched = driven(robot, line)
        assert latched.returncode == 1
        assert "does not start: mode estop: emergency stop: needs a reset" in latched.stderr
        line.write_text(LINE.format(x=here(robot) + 1.0))
        elsewhere = driven(robot, line)
        assert elsewhere.returncode == 78
        assert " m from the robot at x " in elsewhere.stderr
        fast = driven(robot, line, "--speed", "4", "--check")
        assert fast.returncode == 78
        assert "speed = 4: must be above 0 and at most 1.5 m/s" in fast.stderr


def test_only_checked_without_a_robot() -> None:
    def checked(file: str, robot: str) -> subprocess.CompletedProcess[str]:
        robots = PATHS.parent / "robots"
        run = [sys.executable, "-m", "gateway", "path", str(PATHS / f"{file}.toml"), str(robots / f"{robot}.toml")]
        return subprocess.run([*run, "--check", "--json"], capture_output=True, text=True, timeout=60, check=False)

    course, square, wrong = (
        checked("moby_course", "moby"),
        checked("omni4_square", "omni4"),
        checked("omni4_square", "moby"),
    )
    assert json.loads(course.stdout) == pytest.approx(
        {"ok": True, "length": 11.66519, "smallest_radius": 1.5, "seconds": 11.66519 / 0.3 + 0.3 / 0.4}, abs=1e-4
    )
    assert json.loads(square.stdout)["smallest_radius"] == 0.0
    assert wrong.returncode == 78
    assert json.loads(wrong.stdout)["problems"][0].startswith("piece[1] (corner), 2.000 m from the start: turns by")
