"""The first of the two commands of the README, without what takes minutes: setting up is told, not done."""

import os
import shutil
import subprocess
from pathlib import Path

from tests.docs.pages import ROOT

TOLD = '#!/bin/sh\necho "$(basename "$0") $*" >>"$TOLD"\n'


def checkout(folder: Path) -> Path:
    """A checkout with an environment whose tools only tell that they were called."""
    tools = folder / ".venv" / "bin"
    tools.mkdir(parents=True)
    for part in ("deploy", "drivers", "gateway", "replay"):
        (folder / part).mkdir()
    for script in ("demo.sh", "venv.sh", "constraints.txt"):
        shutil.copyfile(ROOT / "deploy" / script, folder / "deploy" / script)
    (folder / "pyproject.toml").touch()
    pip = tools / "pip"
    pip.write_text(TOLD)
    pip.chmod(0o755)
    return folder


def called(folder: Path) -> list[str]:
    told = folder / "told"
    told.write_text("")
    command = ["sh", str(folder / "deploy" / "demo.sh"), "--no-viewer"]
    subprocess.run(command, env=os.environ | {"TOLD": str(told)}, capture_output=True, timeout=60, check=False)
    return told.read_text().splitlines()


def test_it_sets_up_once_and_then_drives(tmp_path: Path) -> None:
    folder = checkout(tmp_path)
    assert [line.split()[:2] for line in called(folder)] == [["pip", "install"]]
    drivegate = folder / ".venv" / "bin" / "drivegate"
    drivegate.write_text(TOLD)
    drivegate.chmod(0o755)
    os.utime(folder / "pyproject.toml", ns=(0, 0))
    for file in (folder / "deploy").iterdir():
        os.utime(file, ns=(0, 0))
    assert called(folder) == ["drivegate demo --no-viewer"]
    (folder / "pyproject.toml").touch()
    newer = drivegate.stat().st_mtime_ns + 1_000_000_000
    os.utime(folder / "pyproject.toml", ns=(newer, newer))
    assert [line.split()[0] for line in called(folder)] == ["pip", "drivegate"]
