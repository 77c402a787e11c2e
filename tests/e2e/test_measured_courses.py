"""`drivegate setup calibrate` against a running, simulated robot: with and without a person, and what it drove."""

import json
import os
import pty
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

from tests.e2e.robot_process import RobotProcess, standing
from tests.setup_robots import TRUE

NAME = "mobyish"
SCALE = 1.02  # of a tape, against which everything is larger


def command(file: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "gateway", "setup", "calibrate", str(file), *more, "--json"]


def called(said: Sequence[str]) -> tuple[int, dict[str, object]]:
    """Without a terminal."""
    done = subprocess.run(said, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=150, check=False)
    found: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return done.returncode, found


def answered(said: Sequence[str], *answers: str) -> tuple[int, dict[str, object]]:
    """With a person on a terminal, who types ahead."""
    person, terminal = pty.openpty()
    with subprocess.Popen(said, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as call:
        os.write(person, "".join(f"{answer}\n" for answer in answers).encode())
        told, _ = call.communicate(timeout=150)
    os.close(terminal)
    os.close(person)
    return call.returncode, json.loads(told.splitlines()[-1])


def here(robot: RobotProcess) -> tuple[float, float]:
    robot.await_state(standing)
    odometry = robot.client.odometry()
    assert odometry is not None
    return odometry.x, odometry.y


def test_courses(tmp_path: Path, free_port: int) -> None:
    file, courses = tmp_path / "robot.toml", tmp_path / "courses.toml"
    # A busy computer holds the loop up for longer than the watchdogs of a real robot would have it.
    before = TRUE[NAME]().replace("timeout = 0.1", "timeout = 0.5")
    file.write_text(before)
    with RobotProcess(NAME, tmp_path, free_port, "--simulate", file=file) as robot:
        drive = ["--connect", robot.endpoint, "--out", str(courses), "--repeat", "1", "--length", "0.4"]
        some = ["--course", "forward", "--course", "left", "--course", "backward", "--course", "right"]
        robot.await_state(standing)
        assert robot.client.reference("platform", 0.0).ok
        code, told = called(command(file, *drive, "--truth"))
        assert (code, told["ok"]) == (1, False)
        assert "a person has to let it happen" in str(told["reason"])
        code, told = answered(command(file, *drive, "--truth"), "no")
        assert (code, told) == (1, {"ok": False, "reason": "nobody let it happen"})
        assert here(robot) == (0.0, 0.0)
        assert not courses.exists()
        other = tmp_path / "other.toml"
        other.write_text(before.replace("track = 0.35", "track = 0.36"))
        code, told = called(command(other, *drive, "--yes", "--truth"))
        assert (code, told["ok"]) == (1, False)
        assert "was started with another robot file" in str(told["reason"])
        assert here(robot) == (0.0, 0.0)
        # A person measures the first course: marks its start, and tells its end in a form that is no number at first.
        code, told = answered(
            command(file, *drive, *some[:2]), "yes", "", "about half a metre", "401 0 0", "0.401 - 0.1"
        )
        assert (code, told["ok"]) == (1, False)
        assert "2 numbers were measured" in str(told["reason"])
        (measured,) = tomllib.loads(courses.read_text())["course"]
        assert (measured["x"], measured.get("y")) == (0.401, None)
        assert abs(measured["turn"] - 0.1 * 3.14159265 / 180.0) < 1e-6
        assert 0.3 < here(robot)[0] < 0.5
        with_tape = courses.read_text().replace("tape = 0.003", "tape = 0.002")
        courses.write_text(with_tape)
        # What the simulated robot tells itself: it is as its file says.
        code, told = called(command(file, *drive, *some, "--yes", "--truth"))
        assert (code, told["ok"]) == (0, True), told
        robot.end()
        assert robot.verify().identical
    numbers = told["numbers"]
    assert isinstance(numbers, list)
    assert all(abs(one["value"] - one["old"]) < 0.01 * one["old"] for one in numbers)
    document = tomllib.loads(courses.read_text())
    assert [len(document["course"]), document["tape"]] == [5, 0.002]  # added to what was there
    assert Path(str(told["kept"])).read_text() == before
    # The same drive, measured with a tape on which everything is larger: nothing moves, no robot is there any more.
    text = courses.read_text()
    for course in tomllib.loads(text)["course"]:
        for key in course.keys() & {"x", "y"}:
            text = text.replace(f"{key} = {course[key]}\n", f"{key} = {SCALE * course[key]}\n")
    courses.write_text(text)
    file.write_text(before)
    code, told = called(command(file, "--measured", str(courses), "--yes"))
    assert (code, told["ok"]) == (0, True), told
    old, new = (tomllib.loads(one)["robot"] for one in (before, file.read_text()))
    for key in ("wheel_radius", "axle_offset", "track"):
        assert abs(new[key] / old[key] - SCALE) < 0.01
