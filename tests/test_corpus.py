"""Recorded drives of every robot: each would go the same again, and together they are in every mode."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.control import limits
from gateway.types import Mode
from replay.sessions.reader import open_session
from tests import corpus
from tests.corpus import FOLDER, ROBOTS, check, record, report, signals


@pytest.mark.parametrize("name", ROBOTS)
def test_it_would_do_the_same_again(name: str) -> None:
    verdict = check(name)
    assert verdict.first_difference is None, "python -m tests.corpus tells what changed; `bless` keeps it"
    assert verdict.identical


def test_every_bundled_robot_and_every_mode_is_there() -> None:
    bundled = {path.stem for path in (Path(__file__).parents[1] / "deploy" / "robots").glob("*.toml")}
    assert set(ROBOTS) == bundled == {path.name for path in FOLDER.iterdir()}
    modes = {outputs.mode for name in ROBOTS for _, outputs in open_session(FOLDER / name).cycles()}
    assert modes == set(Mode)


@pytest.mark.pure_python
def test_a_change_is_reported_signal_by_signal_and_blessed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(corpus, "FOLDER", tmp_path)
    record("omni4", tmp_path / "omni4")
    assert check("omni4").identical
    assert list(report("omni4", signals(open_session(tmp_path / "omni4")))) == ["### omni4", "unchanged"]
    step = limits.TwistLimiter.step
    monkeypatch.setattr(
        limits.TwistLimiter, "step", lambda self, target, dt, **more: step(self, target, 0.9 * dt, **more)
    )
    assert not check("omni4").identical
    lines = list(report("omni4", signals(open_session(tmp_path / "omni4"))))
    assert any(line.startswith("| front_left C620") or "front_left" in line for line in lines)
    record("omni4", tmp_path / "omni4")
    assert check("omni4").identical


def test_the_commands_of_the_workflow_for_robots_run(tmp_path: Path) -> None:
    """Those of deploy/ci/robot.yml, in a folder as it wants one."""
    root = Path(__file__).parents[1]
    shutil.copytree(root / "deploy" / "robots", tmp_path / "robots")
    for name in ("moby", "omni4"):
        shutil.copytree(FOLDER / name, tmp_path / "sessions" / name)
    lines = re.findall(r"run: (.*drivegate .*)", (root / "deploy" / "ci" / "robot.yml").read_text())
    commands = [line.replace("100000", "500") for line in lines if "pip install" not in line]
    assert len(commands) == 3
    script = "set -e\n" + "\n".join(commands).replace("drivegate ", f"{sys.executable} -m gateway ")
    environment = os.environ | {"PYTHONPATH": str(root)}
    done = subprocess.run(
        ["sh", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert 'failures="0"' in (tmp_path / "verdicts.xml").read_text()
