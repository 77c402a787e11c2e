"""`drivegate setup prepare` as a process on a real kernel bus, against the simulated robot in another one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.vm.vcan_robot import drivegate, end, fresh_vcan0, robot_file

pytestmark = pytest.mark.vcan


def called(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_odrives_are_found_wrong_and_set_on_a_real_bus(tmp_path: Path) -> None:
    fresh_vcan0()
    file, flat = robot_file("moby", tmp_path, "vcan0"), tmp_path / "flat_endpoints.json"
    file.write_text(file.read_text().replace(', endpoints_of = "0.6.10 0.0.0"', ""))  # typed by hand
    robot = drivegate("sim", str(file), "--tick", "5", "--flat-endpoints", str(flat), log=tmp_path / "sim.log")
    try:
        while not flat.exists():
            assert robot.poll() is None, (tmp_path / "sim.log").read_text()
        command = [sys.executable, "-m", "gateway", "setup", "prepare", str(file), "--endpoints", str(flat), "--json"]
        calls = [called([*command, *more]) for more in ([], ["--yes"], [])]
    finally:
        end(robot)
    found, done, again = (json.loads(call.stdout.splitlines()[-1]) for call in calls)
    assert [call.returncode for call in calls] == [1, 0, 0], [call.stderr for call in calls]
    assert {line["verdict"] for line in found["lines"]} == {"ok", "no"}
    assert "left: axis0.config.enable_watchdog = true" in done["changed"]
    assert done["kept"]
    assert (again["changed"], again["kept"]) == ([], None)
    assert 'endpoints_of = "0.6.10 5.2.0"' in file.read_text()
