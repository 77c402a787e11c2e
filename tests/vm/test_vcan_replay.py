"""A drive, its frames played back onto the kernel bus, and its commands given again to a live service."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from replay.sessions.reader import open_session
from tests.vm.vcan_robot import GO, ZERO, VcanRobot, candump, fresh_vcan0, heard, sent, standing

pytestmark = pytest.mark.vcan

PORT = 17581


def replay(*arguments: str) -> tuple[int, dict[str, object]]:
    """Exit code and JSON of a `drivegate replay` command."""
    command = [sys.executable, "-m", "gateway", "replay", *arguments, "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=110, check=False)
    lines = done.stdout.splitlines()
    return done.returncode, json.loads(lines[-1]) if lines else {}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A short drive of MOBY, recorded; vcan0 is quiet again."""
    directory = tmp_path_factory.mktemp("recorded")
    fresh_vcan0()
    with VcanRobot("moby", directory, PORT) as robot:
        robot.drive()
        robot.stream(GO, lambda state: state.status.pose.x > 0.4)
        robot.stream(ZERO, standing)
        recorded = robot.finish().path
    yield recorded


@pytest.mark.parametrize("only", ["tx", "rx"])
def test_recorded_frames_are_on_the_bus_again(session: Path, tmp_path: Path, only: str) -> None:
    log = tmp_path / "candump.log"
    with candump(log, "vcan0"):
        code, report = replay("play", str(session), "--channel", "vcan0", "--only", only, "--speed", "4")
    assert code == 0, report
    opened = open_session(session)
    if only == "tx":
        expected = [(identifier, data) for _, identifier, data in sent(opened)]
    else:
        expected = [
            (frame.id, frame.data) for inputs, _ in opened.cycles() for frame in inputs.frames if not frame.remote
        ]
    assert [(frame.id, frame.data) for frame in heard(log)] == expected
    assert isinstance(report["median_error_us"], float)
    assert report["median_error_us"] < 5000.0  # the host's business in here; outside it is 1 ms


def test_commands_are_not_played_where_motors_may_be(session: Path) -> None:
    assert replay("play", str(session), "--channel", "can0") == (2, {})
    assert replay("run", str(session), "--channel", "can0")[0] == 2


def test_the_same_commands_drive_alike(session: Path, tmp_path: Path) -> None:
    code, report = replay("run", str(session), "--channel", "vcan0", "--out", str(tmp_path), "--tick", "5")
    assert code == 0, report["reasons"]
    assert report["similar"] is True
    assert report["modes_redriven"] == report["modes_recorded"]
