"""Robot files: what is wrong is said with file, key, value and range; what follows is right."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.check import examine, frame_bits
from gateway.config import ConfigError, load, parse
from gateway.robot import build
from tests.world import NAMES, ROBOTS, robot_text

WRONG = [
    (
        "moby",
        "gear_ratio = 50.0",
        "gear_ratio = -50.0",
        ["motor[0].gear_ratio = -50.0", "greater than or equal to 0.01"],
    ),
    ("moby", "track = 0.40", "trak = 0.40", ["trak", "not permitted"]),
    ("moby", 'driver = "odrive"', 'driver = "odrvie"', ["odrvie", "dji, odrive"]),
    ("moby", 'variant = "0.6"', 'variant = "0.7"', ["left", "0.7", "0.5", "0.6"]),
    ("moby", "id = 1\n", "id = 63\n", ["motor left: id = 63", "0 to 62"]),
    ("moby", "id = 2\n", "id = 1\n", ["right", "1"]),
    ("moby", 'bus = "can0"', 'bus = "can7"', ["can7", "no such [[bus]]"]),
    ("moby", "axle_offset = 0.25", "axle_offset = 0.0", ["axle_offset", "0.001"]),
    ("moby", "direction = -1", "direction = 0", ["direction", "1"]),
    ("moby", "rate = 250.0", "rate = 5000.0", ["loop.rate = 5000.0", "1000"]),
    ("moby", "left = 22.0", "left = 30.0", ["limits.motor_speed.left = 30.0", "max_speed = 24.0"]),
    ("moby", "platform = 7.0", "roof = 7.0", ["roof", "is no [[motor]]"]),
    ("moby", "priority = 10,", "priority = 100,", ["commands.source.priority = 100", "unique"]),
    ("moby", 'name = "moby"', 'name = "Moby/*"', ["robot", "name"]),
    ("omni4", "axis_angle = 2.0943951023931953", "axis_angle = 1.0471975511965976", []),
    ("omni4", "speed_loop = { kp = 3.5, ki = 14.0 }", "", ["speed_loop is missing"]),
    ("omni4", "watchdog_waiver", "# watchdog_waiver", ["watchdog"]),
]


@pytest.mark.parametrize(("name", "right", "wrong", "words"), WRONG)
def test_wrong_files_are_named_and_explained(name: str, right: str, wrong: str, words: list[str]) -> None:
    text = robot_text(name)
    assert right in text
    broken = text.replace(right, wrong, 1)
    if not words:
        build(parse(broken, "robot.toml"))
        return
    with pytest.raises(ConfigError) as caught:
        build(parse(broken, "robot.toml"), "robot.toml")
    message = str(caught.value)
    assert message.startswith("robot.toml: ")
    assert all(word in message for word in words), message


def test_not_toml_and_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"x\.toml: not valid TOML"):
        parse("[robot", "x.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path / "none.toml")


@pytest.mark.parametrize("name", NAMES)
def test_bundled_robots_are_sound(name: str) -> None:
    report = examine(parse(robot_text(name), name), name)
    assert report.rank == 3
    assert all(possible >= used for possible, used in zip(report.top_speeds, report.reachable, strict=True))
    assert all(bus.load < 0.7 for bus in report.buses)


def test_numbers_of_check_by_hand() -> None:
    """Otbot top speed: the worst heading asks sqrt(10^2 + 8^2) rad/s of a wheel per m/s, of 22 rad/s.

    C620: 4 x 1000 feedback and 250 command frames of 135 bits are 57.4 % of 1 Mbit/s.
    Compensation: ln 3 x 0.25 m / 1.2 m/s = 0.229 s.
    """
    moby = examine(parse(robot_text("moby"), "moby"), "moby")
    assert moby.top_speeds.vx == pytest.approx(22.0 / 164.0**0.5, rel=2e-3)
    assert moby.compensation_period_limit_s == pytest.approx(0.2289, abs=1e-4)
    omni = examine(parse(robot_text("omni4"), "omni4"), "omni4")
    assert omni.buses[0].load == pytest.approx(4250 * 135 / 1e6)
    assert (frame_bits(8, extended=False), frame_bits(8, extended=True)) == (135, 160)


def test_bus_load_is_warned_about_and_refused() -> None:
    text = robot_text("omni4")
    warned = examine(parse(text.replace("rate = 250.0", "rate = 1000.0", 1), "r"), "r")
    assert not any("load" in warning for warning in warned.warnings)
    busy = text.replace("bitrate = 1_000_000", "bitrate = 750_000")
    assert any("load 76%" in warning or "load 77%" in warning for warning in examine(parse(busy, "r"), "r").warnings)
    with pytest.raises(ConfigError, match=r"bus can0: load 115% at 250 Hz; allowed up to 95%"):
        examine(parse(text.replace("bitrate = 1_000_000", "bitrate = 500_000"), "r"), "r")


def drivegate(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gateway", *arguments], capture_output=True, text=True, timeout=60, check=False
    )


def test_check_as_a_user_runs_it(tmp_path: Path) -> None:
    good = drivegate("check", str(ROBOTS / "moby.toml"), "--json")
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["rank"] == 3
    path = tmp_path / "wrong.toml"
    path.write_text(robot_text("moby").replace("gear_ratio = 50.0", "gear_ratio = 0.0", 1))
    for command in ("check", "run"):
        bad = drivegate(command, str(path))
        assert bad.returncode == 78
        assert "wrong.toml: motor[0].gear_ratio = 0.0" in bad.stderr.replace("\n", " ")
        assert "Traceback" not in bad.stderr
    assert json.loads(drivegate("check", str(path), "--json").stdout)["valid"] is False
