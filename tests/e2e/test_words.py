"""What the commands say to a person: one robot, everything that may be asked of it, and what came of that in words."""

import re
import subprocess
import sys
from pathlib import Path

from gateway.types import Mode
from tests.e2e.robot_process import RobotProcess, in_mode
from tests.world import ROBOTS

README = Path(__file__).parent.parent.parent / "README.md"


def drivegate(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gateway", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)


def snippet() -> str:
    """The first Python of the README."""
    found = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found[1]


def test_what_each_command_says(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("moby", tmp_path, free_port) as robot:
        there = ("moby", "--connect", robot.endpoint)

        said = drivegate("send", *there, "--source", "bogus", "--vx", "0.1")
        assert said.returncode == 1
        assert "moby: does not start: no source bogus: the sources are teleop, autonomy" in said.stderr

        said = drivegate("watch", *there, "--once")
        assert re.search(r"sources teleop: \w.*autonomy: \w", " ".join(said.stdout.split())), said.stdout

        said = drivegate("stop", *there)
        assert said.stdout.strip() == "emergency stop confirmed: it stands; latched until `drivegate stop moby --reset`"
        said = drivegate("events", *there)
        assert "mode_estop: emergency stop: needs a reset" in said.stdout
        assert said.returncode == 0
        said = drivegate("stop", *there, "--reset")
        assert said.stdout.startswith("reset granted: idle (")

        said = drivegate("set", *there, "speed_override", "0.5")
        assert said.stdout.strip() == "speed_override = 0.5 until the robot is restarted"
        said = drivegate("reference", *there, "--angle", "0")
        assert said.stdout.strip() == "the steered joint stands at 0 rad, as you said: the robot believes it"

        said = drivegate("watch", "mobi", "--connect", robot.endpoint)
        assert said.returncode == 69
        words = (
            f"mobi does not answer on {robot.endpoint} (as given by --connect); there answers moby: give that as NAME"
        )
        assert words in said.stderr
        assert f"nobody answers as mobi on {robot.endpoint} yet; there answers moby: waiting" in said.stderr

        code = snippet().replace("tcp/127.0.0.1:7447", robot.endpoint)
        said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=False)
        assert said.returncode == 0, said.stderr
        assert "None None" not in said.stdout
        assert "StateMessage" in said.stdout
        assert "OdometryMessage" in said.stdout


def test_a_robot_that_dies_while_it_is_driven_and_followed(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("moby", tmp_path, free_port) as robot:
        command = [sys.executable, "-m", "gateway"]
        there = ("moby", "--connect", robot.endpoint)
        following = subprocess.Popen([*command, "events", *there, "--follow"], stdout=subprocess.PIPE, text=True)
        assert following.stdout is not None
        assert "mode_idle" in following.stdout.readline(), "it is heard before anything happens"
        sending = subprocess.Popen(
            [*command, "send", *there, "--vx", "0.1", "--for", "30"], stderr=subprocess.PIPE, text=True
        )
        robot.await_state(in_mode(Mode.DRIVE), 30.0)
        robot.process.kill()
        _, said = sending.communicate(timeout=60.0)
        assert sending.returncode == 1
        assert "the robot is gone" in said, "whether it was on its way to drive yet or not"
        told, _ = following.communicate(timeout=60.0)
        assert following.returncode == 69
        assert "mode_drive: starting -> drive" in told


def test_the_snippet_says_that_nobody_answers(free_port: int) -> None:
    code = snippet().replace("7447", str(free_port)).replace("wait_alive(5.0)", "wait_alive(0.2)")
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0, check=False)
    assert said.returncode == 1
    assert said.stderr.startswith("moby does not answer")


def test_the_log_says_which_file_unless_it_is_to_be_still(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("moby", tmp_path, free_port) as robot:
        assert robot.end() == 0
        assert f"robot file: {ROBOTS / 'moby.toml'}" in robot.log.read_text()
    still = tmp_path / "still"
    still.mkdir()
    with RobotProcess("moby", still, free_port, "--simulate", "--log-level", "error") as robot:
        assert robot.end() == 0
        assert "INFO" not in robot.log.read_text()
