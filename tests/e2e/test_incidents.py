"""A mark and an emergency stop over Zenoh, with and without sessions: the client learns the file, which verifies."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.edges.messages import EventMessage, StateMessage
from gateway.types import Mode
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.e2e.robot_process import RobotProcess, in_mode
from tests.world import robot_text

SHORT = "[recording.incidents]\npre = 2.0\npost = 0.5\n"
OFF = "[recording]\nenabled = false\n"


def incidents(state: StateMessage) -> dict[str, object]:
    recording = state.extras["recording"]
    assert isinstance(recording, dict)
    found = recording["incidents"]
    assert isinstance(found, dict)
    return found


def events_until(robot: RobotProcess, code: str) -> list[EventMessage]:
    """Of this code; those that come before it are of no interest."""
    found: list[EventMessage] = []

    def there(_: StateMessage) -> bool:
        found.extend(event for event in robot.client.events() if event.code == code)
        return bool(found)

    robot.await_state(there, timeout=60.0)
    return found


@pytest.mark.parametrize("recording", ["", OFF])
def test_a_mark_and_a_stop(recording: str, tmp_path: Path, free_port: int) -> None:
    file = tmp_path / "moby.toml"
    file.write_text(robot_text("moby") + "\n" + recording + SHORT, encoding="utf-8")
    sessions = tmp_path / "sessions"
    sessions.mkdir()
    with RobotProcess("moby", sessions, free_port, file=file) as robot:
        robot.start()
        state = robot.await_state(in_mode(Mode.DRIVE, Mode.STOPPING, Mode.IDLE))
        assert incidents(state) == {"kept": 0, "failed": 0, "file": None, "error": None, "pending": False}
        command = [sys.executable, "-m", "gateway", "mark", str(file), "it squeals", "--connect", robot.endpoint]
        done = subprocess.run([*command, "--json"], capture_output=True, text=True, timeout=60, check=False)
        assert json.loads(done.stdout) == {"ok": True, "reason": None}, done.stderr
        (told,) = events_until(robot, "incident")
        state = robot.await_state(lambda state: incidents(state)["kept"] == 1)
        assert incidents(state)["file"] == told.text
        marked = open_session(Path(told.text))
        assert verify(marked).identical
        incident = marked.header.incident
        assert incident is not None
        assert [(cause.code, cause.text) for cause in incident.causes] == [("mark", "it squeals")]
        assert incident.judgement is not None
        assert incident.judgement.verdict == "identical"

        assert robot.client.stop()
        (told,) = events_until(robot, "incident")
        assert "-estop-2.rrd" in told.text
        assert verify(open_session(Path(told.text))).identical
        assert robot.end() == 0
    assert bool([path for path in sessions.iterdir() if path.name.startswith("moby-")]) is not bool(recording)
    if not recording:
        assert robot.verify().identical


def test_words_that_are_none_are_refused_before_anybody_is_asked() -> None:
    command = [sys.executable, "-m", "gateway", "mark", "moby", "two\nlines"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "must be 1 to 200 printable characters in one line" in done.stderr
