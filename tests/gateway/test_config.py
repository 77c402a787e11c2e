"""Robot files: what is wrong is said with file, key, value and range; what follows is right."""

import copy
import json
import math
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers import DRIVERS
from drivers.contract import Capabilities, Traffic
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import CommandKind, MotorCommand
from gateway.config import Bus, ConfigError, load, parse
from gateway.core.assembly import build
from gateway.core.engine import Engine
from gateway.core.examination import examine, frame_bits, frame_time
from tests.world import BUNDLED, NAMES, ROBOTS, robot_text

WRONG = [
    (
        "moby",
        "gear_ratio = 50.0",
        "gear_ratio = -50.0",
        ["motor[0].gear_ratio = -50.0", "must be a number, 0.01 to 1000 motor turns per output turn"],
    ),
    ("moby", "track = 0.40", "trak = 0.40", ["trak = 0.4: unknown key"]),
    ("moby", 'driver = "odrive"', 'driver = "odrvie"', ["odrvie", "dji, odrive"]),
    ("moby", 'variant = "0.6"', 'variant = "0.7"', ["left", "0.7", "0.5", "0.6"]),
    ("moby", "id = 1\n", "id = 63\n", ["motor left: id = 63", "0 to 62"]),
    ("moby", "id = 2\n", "id = 1\n", ["right", "1"]),
    (
        "moby",
        "bitrate = 1_000_000",
        "bitrate = 1_000_000\ndata_bitrate = 2_000_000",
        ["bus[0]", "data_bitrate = 2000000: needs fd = true"],
    ),
    ("moby", 'bus = "can0"', 'bus = "can7"', ["can7", "no such [[bus]]"]),
    ("moby", "axle_offset = 0.25", "axle_offset = 0.0", ["axle_offset", "0.001"]),
    ("moby", "direction = -1", "direction = 0", ["direction", "1"]),
    ("moby", "rate = 250.0", "rate = 5000.0", ["loop.rate = 5000.0", "1000"]),
    ("moby", "left = 22.0", "left = 30.0", ["limits.motor_speed.left = 30.0", "max_speed = 24.0"]),
    ("moby", "platform = 7.0", "roof = 7.0", ["roof", "is no [[motor]]"]),
    ("moby", "priority = 10,", "priority = 100,", ["commands.source.priority = 100", "unique"]),
    ("moby", 'name = "moby"', 'name = "Moby/*"', ["robot", "name"]),
    ("omni4", "axis_angle = 2.0943951023931953", "axis_angle = 1.0471975511965976", []),
    (
        "omni4",
        "centre_height = 0.10",
        "centre_height = 0.0",
        ["robot.body.centre_height = 0.0", "must be a number, above 0 to 10 m"],
    ),
    ("omni4", "x = 0.10\n", "", ["robot.toml: robot.wheel[0].x: missing"]),
    ("omni4", "x = 0.10\n", "ex = 0.10\n", ["robot.wheel[0].ex = 0.1: unknown key"]),
    ("omni4", "x = 0.10\n", "x = 10.5\n", ["robot.wheel[0].x = 10.5: must be a number, -10 to 10 m"]),
    (
        "omni4",
        '"tcp/127.0.0.1:7448"',
        '"127.0.0.1:7448"',
        ["zenoh.listen[0] = '127.0.0.1:7448'", "a protocol and an addr"],
    ),
    (
        "omni4",
        '"tcp/127.0.0.1:7448"',
        '"tcp/127.0.0.1"',
        ["zenoh.listen[0] = 'tcp/127.0.0.1'", "with a port up to 65535"],
    ),
    (
        "omni4",
        "127.0.0.1:7448",
        "127.0.0.1:70000",
        ["zenoh.listen[0] = 'tcp/127.0.0.1:70000'", "with a port up to 65535"],
    ),
    (
        "omni4",
        "centre_height = 0.10",
        "centre_height = 100",
        ["centre_height = 100", "must be a number, above 0 to 10 m"],
    ),
    ("omni4", "speed_loop = { kp = 3.5, ki = 14.0 }", "", ["speed_loop is missing"]),
    ("omni4", "watchdog_waiver", "# watchdog_waiver", ["watchdog"]),
    (
        "moby",
        "feedback_rate = 250.0",
        "feedback_rate = 1.0",
        ["motor left: feedback_rate = 1", "10 to 1000 Hz", "silent"],
    ),
    ("moby", "feedback_rate = 250.0\n", "", ["motor left: feedback_rate is missing", "10 to 1000 Hz", "silent"]),
    ("moby", "feedback_rate = 250.0", "feedback_rate = 0.004", ["motor left: feedback_rate = 0.004", "10 to 1000 Hz"]),
    ("moby", "feedback_rate = 250.0", "feedback_rate = 1e-300", ["motor left: feedback_rate = 1e-300", "10 to 1000"]),
    (
        "omni4",
        "feedback_rate = 1000.0",
        "feedback_rate = 29.0",
        ["motor front_left: feedback_rate = 29", "29.4", "turns"],
    ),
    (
        "moby",
        "timeout = 0.1 }",
        "timeout = 0.01 }",
        ["motor left: watchdog.timeout = 0.01", "0.012 to 1 s", "a lost frame"],
    ),
    ("moby", "[loop]\nrate = 250.0", "[loop]\nrate = 20.0", ["motor left: watchdog.timeout = 0.1", "0.15 to 1 s"]),
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


def test_speed_loops_follow_the_capabilities_of_each_motor_of_a_group(monkeypatch: pytest.MonkeyPatch) -> None:
    """Moby's three motors are one group of one driver."""
    full = Capabilities(velocity=True, torque=True, brake=True, feed_forward=True, device_watchdog=True)
    assert build(parse(robot_text("moby"), "moby")).capabilities == (full,) * 3
    able = (full, Capabilities(torque=True), Capabilities(voltage=True))
    monkeypatch.setattr(OdriveDriver, "capabilities", property(lambda _: able))
    with pytest.raises(ConfigError) as caught:
        build(parse(robot_text("moby"), "moby"))
    missing, useless = caught.value.problems
    assert missing == "motor right: speed_loop is missing: its controller takes only torque"
    assert useless == "motor platform: speed_loop is missing: its controller takes only a voltage"
    able = (full, Capabilities(torque=True), full)
    gains = "speed_loop = { kp = 1.0, ki = 1.0 }\n"
    robot = build(parse(robot_text("moby").replace("id = 2\n", "id = 2\n" + gains, 1), "moby"))
    assert [loop is not None for loop in robot.speed_loops] == [False, True, False]
    helped = Capabilities(velocity=True, torque=True, brake=True, feed_forward=True, limit=True)
    assert robot.capabilities == (full, helped, full), "with a loop on the host the joint obeys a limit too"


OPTIONS = 'options = { firmware = "0.6.10", watchdog_enable_endpoint = 188, watchdog_timeout_endpoint = 189 }'


def unbound() -> str:
    """Moby as it was when nothing said what its endpoints belong to."""
    return robot_text("moby").replace(', endpoints_of = "0.6.10 0.0.0"', "")


def test_options_are_for_the_driver_to_judge() -> None:
    text = unbound()
    left = parse(text, "moby").motors_in_order()[0]
    assert left.options == {"firmware": "0.6.10", "watchdog_enable_endpoint": 188, "watchdog_timeout_endpoint": 189}
    wrong = {
        OPTIONS: "options = { poles = 7 }",
        '"0.6.10"': "0.6",
        "watchdog_enable_endpoint = 188": "watchdog_enable_endpoint = 188.0",
        "watchdog_timeout_endpoint = 189": "watchdog_timeout_endpoint = true",
        ", watchdog_timeout_endpoint = 189": "",
    }
    words = [".poles = 7: no such option", "firmware = 0.6: must", "= 188.0: must", "= True: must", "is missing"]
    for (right, other), word in zip(wrong.items(), words, strict=True):
        assert right in text
        with pytest.raises(ConfigError, match=f"robot.toml: motor left: options.*{word}"):
            build(parse(text.replace(right, other, 1), "robot.toml"), "robot.toml")


@pytest.mark.parametrize(
    "value", ["nan", "-inf", "1e16", "1" * 400, "[1]", "{ a = 1 }", "2026-01-01", f'"{"x" * 257}"']
)
def test_what_no_option_can_be(value: str) -> None:
    text = unbound().replace(OPTIONS, f"options = {{ firmware = {value} }}", 1)
    with pytest.raises(ConfigError) as caught:
        parse(text, "robot.toml")
    (problem,) = caught.value.problems
    assert problem.startswith("motor[0].options.firmware")
    assert problem.endswith("must be a number from -1e15 to 1e15, a text of at most 256 characters, true or false")


BEFORE = 'watchdog = { timeout = 0.1, firmware = "0.6.10", enable_endpoint = 188, timeout_endpoint = 189 }\n'


def test_the_parameter_numbers_of_an_odrive_may_still_be_where_recorded_robot_files_have_them() -> None:
    text = unbound()
    now = f"watchdog = {{ timeout = 0.1 }}\n{OPTIONS}\n"
    assert text.count(now) == 3
    assert parse(text.replace(now, BEFORE), "moby") == parse(text, "moby")
    with pytest.raises(ConfigError, match=r"motor left: options.watchdog_enable_endpoint = 0: must be 1 to 65535"):
        build(parse(text.replace(now, BEFORE.replace("188", "0"), 1), "moby"))
    with pytest.raises(ConfigError, match=r"motor\[0\].watchdog.firmware = '0.6.10': unknown key"):
        parse(text.replace(now, BEFORE + OPTIONS + "\n", 1), "moby")


C620 = """
[[motor]]
name = "{name}"
driver = "dji"
variant = "c620"
bus = "{bus}"
id = {id}
gear_ratio = 19.2
direction = 1
max_current = 20.0
max_torque = 4.5
max_speed = 48.0
feedback_rate = 1000.0
watchdog_waiver = "the e-stop relay cuts the supply of the motors"
speed_loop = {{ kp = 2.0, ki = 4.0 }}
"""


def mixed(node: int, number: int, *, channel: str = "can0", second_bus: str = "can0") -> str:
    """Moby with a C620 for the platform, on a bus of its own if asked; `node` is the left wheel's."""
    text = robot_text("moby").replace("id = 1\n", f"id = {node}\n", 1)
    head, _, tail = text.rpartition('[[motor]]\nname = "platform"')
    commands = tail[tail.index("[commands]") :]
    bus = f'[[bus]]\nname = "{second_bus}"\ninterface = "socketcan"\nchannel = "{channel}"\nbitrate = 1_000_000\n'
    return head + C620.format(name="platform", bus=second_bus, id=number) + bus * (second_bus != "can0") + commands


def problem_of(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        examine(parse(text, "robot.toml"), "robot.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("node", "number", "words"),
    [
        (16, 1, ["odrive node 16 of motor left (0x200 to 0x21F)", "dji command of motor platform (0x200)"]),
        (16, 8, ["odrive node 16 of motor left (0x200 to 0x21F)", "dji feedback of motor platform (0x208)"]),
        (15, 5, ["odrive node 15 of motor left (0x1E0 to 0x1FF)", "dji command of motor platform (0x1FF)"]),
        (56, 1, ["odrive node 56 of motor left (0x700 to 0x71F)", "dji setting of ids (0x700)"]),
    ],
)
def test_controllers_that_would_hear_each_other_are_refused(node: int, number: int, words: list[str]) -> None:
    message = problem_of(mixed(node, number))
    assert message.startswith("robot.toml: bus can0: ")
    assert all(word in message for word in words), message
    examine(parse(mixed(node, number, second_bus="can1", channel="can1"), "r"), "r")
    examine(parse(mixed(17, number), "r"), "r")


def test_two_buses_on_one_channel_are_refused_by_name() -> None:
    message = problem_of(mixed(17, 1, second_bus="wheels", channel="can0"))
    assert "bus wheels: interface = 'socketcan', channel = 'can0': already the channel of bus can0" in message


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("pre = 0.5", "recording.incidents.pre = 0.5: must be a number, 1 to 120 s"),
        ("pre = 121.0", "recording.incidents.pre = 121.0: must be a number, 1 to 120 s"),
        ("post = 61.0", "recording.incidents.post = 61.0: must be a number, 0.5 to 60 s"),
        ("budget = 1000", "recording.incidents.budget = 1000: must be"),
        ("after = 5.0", "recording.incidents.after = 5.0: unknown key"),
    ],
)
def test_how_much_of_an_incident_may_be_kept(line: str, words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)):
        parse(f"{robot_text('moby')}\n[recording.incidents]\n{line}\n", "moby")


def places(table: object, path: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    """Where the numbers of a document are."""
    if isinstance(table, dict):
        return [place for key, value in table.items() for place in places(value, (*path, key))]
    if isinstance(table, list):
        return [place for key, value in enumerate(table) for place in places(value, (*path, key))]
    return [path] if isinstance(table, int | float) and not isinstance(table, bool) else []


# Everything that the bundled files leave to its default, too.
MORE: dict[str, Any] = {
    "zenoh": {"odometry_rate": 50.0, "state_rate": 10.0, "view_rate": 20.0},
    "recording": {"segment_seconds": 300.0, "segment_bytes": 10**8, "disk_budget": 10**9, "min_free": 10**8}
    | {"incidents": {"pre": 20.0, "post": 5.0, "budget": 10**8}},
    "stop": {"category": 1},
}
VOLTS = "omni4_gm6020"  # of which only what the others have not
DOCUMENTS = {name: MORE | tomllib.loads(robot_text(name)) for name in (*NAMES, VOLTS)}
for document in DOCUMENTS.values():
    document["zenoh"] = MORE["zenoh"] | document["zenoh"]
PLACES = [(name, place) for name in NAMES for place in places(DOCUMENTS[name])]
PLACES += [(VOLTS, place) for place in places(DOCUMENTS[VOLTS]) if {"winding", "speed_loop"} & set(place)]
NUMBERS = st.one_of(
    st.floats(),
    st.integers(),
    st.sampled_from(
        [math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, 1e-310, 1e-300, 1e-20, 1e300, 10**400, -(10**400)]
    ),
)


def with_number(name: str, place: tuple[object, ...], number: float) -> str:
    document = copy.deepcopy(DOCUMENTS[name])
    table: Any = document
    for key in place[:-1]:
        table = table[key]
    table[place[-1]] = number
    return toml(document)


def toml(document: dict[str, Any]) -> str:
    """Enough of TOML for a robot file; sections as inline tables."""
    return "\n".join(f"{key} = {inline(item)}" for key, item in document.items())


def inline(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {inline(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def valid_or_named(name: str, place: tuple[object, ...], number: float) -> bool:
    """Whether it is a robot to drive with; if not, that number is what is complained of."""
    try:
        config = parse(with_number(name, place, number), "r.toml")
        examine(config, "r.toml")
        Engine(config)
    except ConfigError as error:
        key = next(part for part in reversed(place) if isinstance(part, str))
        assert str(error).startswith("r.toml: ")
        assert key in str(error) or (key == "bitrate" and "load" in str(error)), error
        return False
    return True


def test_the_document_as_it_is_is_valid() -> None:
    assert all(valid_or_named(name, ("loop", "rate"), 250.0) for name in NAMES)
    assert len(PLACES) > 80


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 10**400, -1e300])
def test_no_key_takes_what_is_no_number_of_any_use(number: float) -> None:
    taken = [place for name, place in PLACES if valid_or_named(name, place, number)]
    assert taken == []


@pytest.mark.parametrize("number", [0.0, 5e-324, 1e-300, 1e-9, 1e9])
def test_extreme_numbers_in_any_key_are_valid_or_named(number: float) -> None:
    for name, place in PLACES:
        valid_or_named(name, place, number)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(PLACES), st.floats(-2.0, 2.0))
def test_a_number_up_to_a_hundred_times_off_is_valid_or_named(
    where: tuple[str, tuple[object, ...]], decades: float
) -> None:
    """What a slip of the finger or of the unit makes of a sound robot file: where the limits meet each other."""
    name, place = where
    number: Any = DOCUMENTS[name]
    for key in place:
        number = number[key]
    assume(isinstance(number, int | float))
    valid_or_named(name, place, type(number)(number * 10.0**decades))


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(PLACES), NUMBERS)
def test_any_number_in_any_key_is_valid_or_named(where: tuple[str, tuple[object, ...]], number: float) -> None:
    valid_or_named(*where, number)


def test_numbers_and_tables_without_end_are_no_toml() -> None:
    for text in (f"a = {'9' * 5000}", f"a = {'[' * 100_000}"):
        with pytest.raises(ConfigError, match=r"x\.toml: not valid TOML"):
            parse(text, "x.toml")


def test_not_toml_and_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"x\.toml: not valid TOML"):
        parse("[robot", "x.toml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path / "none.toml")


def test_every_robot_file_is_known_to_the_tests() -> None:
    assert {path.stem for path in ROBOTS.glob("*.toml")} == set(BUNDLED)


@pytest.mark.parametrize("name", BUNDLED)
def test_bundled_robots_are_sound(name: str) -> None:
    report = examine(parse(robot_text(name), name), name)
    assert report.rank == len(report.axes)
    assert all(possible >= used for possible, used in zip(report.top_speeds, report.reachable, strict=True))
    assert all(bus.load < 0.7 for bus in report.buses)


def test_numbers_of_check_by_hand() -> None:
    """Otbot top speed: the worst heading asks sqrt(10^2 + 8^2) rad/s of a wheel per m/s, of 22 rad/s.

    C620: 4 x 1000 feedback and 250 command frames of 135 bits are 57.4 % of 1 Mbit/s.
    Compensation: ln 3 x 0.25 m / 1.2 m/s = 0.229 s.
    """
    moby = examine(parse(robot_text("moby"), "moby"), "moby")
    assert moby.top_speeds[0] == pytest.approx(22.0 / 164.0**0.5, rel=2e-3)
    (compensation,) = moby.loop_limits
    assert compensation.name == "compensation"
    assert compensation.period == pytest.approx(0.2289, abs=1e-4)
    omni = examine(parse(robot_text("omni4"), "omni4"), "omni4")
    assert omni.buses[0].load == pytest.approx(4250 * 135 / 1e6)
    assert (frame_bits(8, extended=False), frame_bits(8, extended=True)) == (135, 160)


def test_the_time_of_an_fd_frame_has_two_rates() -> None:
    """64 bytes, standard id: 34 bits before and behind, 678 between the switches; see test_sim_wire."""
    bus = Bus(name="can0", interface="virtual", channel="a", bitrate=500_000, fd=True, data_bitrate=4_000_000)
    plain = bus.model_copy(update={"data_bitrate": None})
    fast = Traffic("x", extended=False, length=64, rate_hz=1.0, fd=True, bit_rate_switch=True)
    assert frame_time(fast, bus) == pytest.approx(34 / 5e5 + 678 / 4e6)
    assert frame_time(fast._replace(bit_rate_switch=False), bus) == pytest.approx(712 / 5e5)
    assert frame_time(fast, plain) == pytest.approx(712 / 5e5)
    assert frame_time(Traffic("x", False, 8, 1.0), bus) == pytest.approx(135 / 5e5)


@pytest.mark.pure_python  # a driver made from one of ours
def test_a_driver_of_fd_frames_needs_an_fd_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    class Talkative(OdriveDriver):
        def traffic(self, *, loop_rate_hz: float) -> tuple[Traffic, ...]:
            return (Traffic("m setpoint", False, 64, loop_rate_hz, fd=True, bit_rate_switch=True),)

    monkeypatch.setitem(DRIVERS, "odrive", Talkative)
    text = robot_text("moby")
    with pytest.raises(ConfigError, match="bus can0: fd = false: m setpoint is a CAN FD frame"):
        build(parse(text, "r"))
    build(parse(text.replace("bitrate = 1_000_000", "bitrate = 1_000_000\nfd = true\ndata_bitrate = 5_000_000"), "r"))


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


def test_a_robot_that_takes_too_long_to_stop_is_refused() -> None:
    """A jerk limit of 0.01 would let the robot drive on for half a minute."""
    text = robot_text("moby").replace("jerk = { vx = 4.0,", "jerk = { vx = 0.01,")
    with pytest.raises(ConfigError, match=r"a stop from top speed takes .* allowed up to 5 s"):
        examine(parse(text, "r"), "r")


@pytest.mark.parametrize(
    ("right", "wrong", "words"),
    [
        ("jerk = { vx = 15.0", "jerk = { vx = 0.15", "raise limits.jerk.vx, or lower limits.acceleration.vx"),
        ("ion = { vx = 2.0", "ion = { vx = 0.2", "raise limits.acceleration.vx, or lower limits.velocity.vx"),
        ("ion = { vx = 2.0", "ion = { vx = 200.0", "raise limits.jerk.vx, or lower limits.acceleration.vx"),
    ],
)
def test_what_would_stop_it_sooner_is_told(right: str, wrong: str, words: str) -> None:
    """An acceleration that its jerk takes seconds to reach is lowered, not raised."""
    text = robot_text("omni4")
    assert right in text
    with pytest.raises(ConfigError, match=f"allowed up to 5 s: {words}"):
        examine(parse(text.replace(right, wrong), "r"), "r")


def test_a_speed_loop_that_swings_without_end_is_refused() -> None:
    """omni4's wheels give way by 27.28 rad/s^2 per N m at most: 3.5 N m per rad/s take 477 % of an error in 50 ms."""
    slow = robot_text("omni4", rate_hz=20.0)
    words = r"motor front_left: speed_loop.kp = 3.5: takes back 477% of .* loop.rate = 20 Hz; allowed up to 100%"
    with pytest.raises(ConfigError, match=words):
        examine(parse(slow, "r"), "r")
    with pytest.raises(ConfigError, match=r"takes back 101% of .* kp up to 9\.1\d, or raise loop.rate"):
        examine(parse(robot_text("omni4").replace("kp = 3.5", "kp = 9.26"), "r"), "r")
    examine(parse(robot_text("omni4").replace("kp = 3.5", "kp = 9.1"), "r"), "r")


def test_what_a_stop_and_a_curve_ask_of_the_robot_is_told() -> None:
    moby, omni = (examine(parse(robot_text(name), name), name) for name in ("moby", "omni4"))
    assert 1.7 < moby.stopping_time_s < 3.0
    assert 0.5 * 1.7 * 1.7 < moby.stopping_distance_m < 3.0
    assert omni.turning_share == pytest.approx((0.7 * 1.5 / 8.0) ** 0.5)
    # omni4 by hand: 25 kg at 2.0 and 1.5 m/s^2 and 0.9 kg m^2 at 6 rad/s^2, on four wheels at 60 degrees and 0.2 m
    force = 50.0 / (4 * 0.75**0.5) + 37.5 / (4 * 0.5) + 5.4 / (4 * 0.2)
    assert omni.torque_share == pytest.approx((force * 0.0762 + 0.09 + 0.02 * 45.0 / 2) / 4.5, rel=1e-6)
    heavy = robot_text("omni4").replace("mass = 25.0", "mass = 150.0")
    assert any("of the torque of motor" in warning for warning in examine(parse(heavy, "r"), "r").warnings)


def test_check_draws_and_tells_how_hard_omni4_pushes_in_each_direction() -> None:
    """Of 30 degrees: 4 cos 30 forward, 4 sin 30 sideways, least 3^0.5 at 30 degrees from sideways; 4.5 N m at 76 mm."""
    told = json.loads(drivegate("check", "omni4", "--json").stdout)["effective_motors"]
    assert told["force"] == pytest.approx(4.5 / 0.0762)
    every = {"forward": 3.4641016, "diagonal": 1.7931509, "sideways": 2.0, "least": 1.7320508}
    assert told["every"] == pytest.approx({**every, "least_direction": 1.0471976})
    assert (len(told["directions"]), len(told["motors"])) == (72, 72)
    assert told["motors"][9] == pytest.approx(told["motors"][45]), "45 degrees, and the other way"
    assert [told["motors"][place] for place in (0, 9, 18)] == pytest.approx([3.4641016, 1.7931509, 2.0])
    assert list(told["without"]) == ["front_left", "rear_left", "rear_right", "front_right"]
    assert told["without"]["rear_left"]["forward"] == pytest.approx(1.7320508)
    assert json.loads(drivegate("check", "moby", "--json").stdout)["effective_motors"] is None
    shown = drivegate("check", "omni4").stdout
    assert " -------oo----------+----------oo-------" in shown
    assert "1.73 at 60 deg" in shown
    assert "effective" not in drivegate("check", "moby").stdout


# -- motors that are told voltages ------------------------------------------------------------------------------------

WINDING = "winding = { resistance = 8.7, back_emf = 0.741, voltage = 24.0 }"


@pytest.mark.parametrize(
    ("right", "wrong", "words"),
    [
        ("speed_loop = { kp = 0.5, ki = 1.2 }", "", "speed_loop is missing: its controller takes only a voltage"),
        (WINDING, "", "winding is missing: a gm6020 in voltage mode gives a share of its supply"),
        (WINDING, WINDING.replace("24.0", "48.0"), "winding.voltage = 48: must be 18 to 28 V"),
        (WINDING, WINDING.replace("8.7", "0.0"), "winding.resistance = 0.0: must be a number, 0.001 to 100 ohm"),
        ("max_current = 1.62", "max_current = 1.0", "max_torque = 1.2: must be at most 0.741: what max_current and"),
        ('mode = "voltage"', 'mode = "torque"', "options.mode = 'torque': must be 'current' or 'voltage'"),
        ("id = 1 ", "id = 0 ", "id = 0: must be 1 to 7 for gm6020"),
    ],
)
def test_what_a_motor_needs_that_is_told_voltages(right: str, wrong: str, words: str) -> None:
    text = robot_text(VOLTS)
    assert right in text
    with pytest.raises(ConfigError) as caught:
        build(parse(text.replace(right, wrong, 1), "r"))
    assert f"motor front_left: {words}" in str(caught.value) or f"motor[0].{words}" in str(caught.value)


def test_a_torque_becomes_a_voltage_only_where_the_controller_takes_nothing_else() -> None:
    """By hand, through a gear of 2 the wrong way round: 1.2 N m and 5 rad/s are 0.6 and 10 at the shaft."""
    text = robot_text(VOLTS).replace("gear_ratio = 1.0\ndirection = 1", "gear_ratio = 2.0\ndirection = -1", 1)
    text = text.replace("id = 2                 #", "id = 2  #").replace('mode = "voltage"', 'mode = "current"')
    text = text.replace('mode = "current"', 'mode = "voltage"', 1).replace("max_speed = 26.0", "max_speed = 12.0")
    for speed in ("front_left", "rear_left", "rear_right", "front_right"):
        text = text.replace(f"{speed} = 24.0", f"{speed} = 12.0")
    robot = build(parse(text, "r"))
    first, second, *_ = robot.transmissions
    told = first.torque_command(1.2, 5.0)
    assert told.kind is CommandKind.VOLTAGE
    assert told.value == pytest.approx(-(0.6 * 8.7 / 0.741 + 0.741 * 10.0))
    assert first.torque_command(1.2, None) == MotorCommand(CommandKind.VOLTAGE, 0.0), "nothing drives blind"
    assert second.torque_command(1.2, 5.0) == second.torque_command(1.2, None) == MotorCommand(CommandKind.TORQUE, 1.2)
    joints = {(able.velocity, able.torque, able.voltage, able.brake, able.feed_forward) for able in robot.capabilities}
    assert joints == {(True, True, True, True, True), (True, True, False, True, True)}


def test_check_tells_what_torque_the_supply_leaves_at_top_speed() -> None:
    """By hand: 24 V less 0.741 * 24 rad/s, through 8.7 ohm, times 0.741."""
    text = robot_text(VOLTS)
    words = (
        "motor front_left: at limits.motor_speed = 24 rad/s winding.back_emf takes 17.8 of winding.voltage = 24 V, "
        "which leaves 0.529 N m of max_torque = 1.2"
    )
    assert words in examine(parse(text, "r"), "r").warnings
    slow = text.replace("_left = 24.0", "_left = 13.0").replace("_right = 24.0", "_right = 13.0")
    assert not any("winding" in warning for warning in examine(parse(slow, "r"), "r").warnings)
    with pytest.raises(
        ConfigError, match=r"motor front_left: .* takes 24.1 of winding.voltage = 24 V, .* leaves nothing"
    ):
        examine(parse(text.replace("0.741,", "1.004,", 1), "r"), "r")
