"""Packages that a process does without, installed or not."""

import subprocess
import sys
from pathlib import Path

import pytest

from gateway.recording.recorder import Recorder
from tests.recordings import robot, robot_text

PICTURE = """
import rerun as rr, rerun.blueprint as rrb
rr.set_strict_mode(True)
assert rrb.PlotLegend(rrb.Corner2D.RightTop).corner.as_arrow_array().to_pylist() == [2]
"""
AGAIN = """
from gateway.edges.hidden import hidden
with hidden("pandas"):
    try:
        import pandas
    except ModuleNotFoundError as error:
        assert error.name == "pandas"
    else:
        raise SystemExit("it was there")
import pandas
"""


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    return done.stderr


def test_arrow_does_without_pandas() -> None:
    found = "import sys; sys.exit(str(sorted(n for n in sys.modules if n.startswith('pandas'))))"
    assert run(f"from gateway.edges.hidden import hide; hide('pandas'){PICTURE}{found}") == "[]\n"


def test_it_is_there_again_afterwards() -> None:
    assert run(AGAIN) == ""


def test_a_recorder_begins_without_a_warning(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    Recorder(robot(tmp_path), robot_text(), "moby.toml").close(20.0)
    assert list(tmp_path.glob("*/*.rrd"))
    assert capfd.readouterr().err == ""
