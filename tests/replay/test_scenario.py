"""Scenario files: what they may say, that they run alike every time, and how their expectations are judged."""

import csv
import json
import subprocess
import sys
from collections.abc import Sequence
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

import pytest

from gateway.config import ConfigError, load, parse_as
from gateway.types import Mode, RequestKind
from replay.compare.verify import verify
from replay.drive.closed_loop import FIRST_NS
from replay.drive.moment import Moment
from replay.drive.recording import SessionRecording
from replay.drive.scenario import RESTART_S, Result, run_scenario
from replay.drive.scenario_file import Scenario, check_names, load_scenario
from replay.drive.trace import TraceWriter, columns
from replay.sessions.reader import open_session
from replay.sim.plants import PLANTS
from replay.sim.plants.contract import PlantName
from tests.world import BUNDLED, ROBOTS

ZERO = {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}
AHEAD = ZERO | {"vx": 0.4}
DRIVE: tuple[dict[str, Any], ...] = ({"t": 0.3, "command": ZERO}, {"t": 1.0, "command": AHEAD})

TEXT = """
robot = "moby"
seconds = 6
seed = 3
[start]
joint.platform = 0.3
[[at]]
t = 0.3
command = { source = "teleop", vx = 0, vy = 0, wz = 0 }
[[at]]
t = 1
command = { source = "teleop", vx = 0.4, vy = 0.1, wz = 0.2, rate = 33 }
[[at]]
t = 2
fault = { kind = "frames_lost", value = 0.2, seconds = 0.5 }
[[at]]
t = 3
fault = { kind = "friction", motor = "left", value = 0.05 }
[[at]]
t = 4
request = "estop"
[[at]]
t = 4.5
request = "restart"
"""


def scenario(robot: str = "omni4", seconds: float = 3.0, **parts: object) -> Scenario:
    return Scenario.model_validate({"robot": robot, "seconds": seconds, **parts})


def moments(wanted: Scenario) -> list[Moment]:
    seen: list[Moment] = []
    run_scenario(wanted, watch=seen.append)
    return seen


def expecting(*expect: dict[str, Any], at: Sequence[dict[str, Any]] = DRIVE, seconds: float = 3.0) -> tuple[str, ...]:
    return run_scenario(scenario(seconds=seconds, at=list(at), expect=list(expect))).broken


def command_line(*arguments: object) -> subprocess.CompletedProcess[str]:
    run = [sys.executable, "-m", "gateway", "scenario", *map(str, arguments)]
    return subprocess.run(run, capture_output=True, text=True, timeout=100, check=False)


# -- the file ---------------------------------------------------------------------------------------------------------

WRONG = {
    "colour = 'red'": "colour",
    "seconds = -1": "seconds = -1",
    "seed = 'x'": "seed",
    "[[at]]\nt = 99\nsilence = 'teleop'": "at[0].t = 99.0: must be 0 to seconds = 5.0",
    "[[at]]\nt = 1": "at[0]: must have exactly one of command, silence, request, set, fault, has none",
    "[[at]]\nt = 1\nsilence = 'teleop'\nrequest = 'estop'": "has silence and request",
    "[[at]]\nt = 1\nset = { speed = 0.5 }": "at[0]: 'speed': must be one of speed_override",
    "[[at]]\nt = 1\nset = { speed_override = 7 }": "at[0]: speed_override = 7: must be 0.05 to 1",
    "[[at]]\nt = 1\nrequest = 'dance'": "at[0].request = 'dance'",
    "[[at]]\nt = 1\nrequest = 'estop'\nangle = 1.0": "belongs to request = 'reference' only",
    "[[at]]\nt = 1\ncommand = { source = 'teleop', vx = 99, vy = 0, wz = 0 }": "at[0].command.vx = 99",
    "[[at]]\nt = 1\ncommand = { source = 'teleop', vx = 0, vy = 0, wz = 0, rate = 0 }": "at[0].command.rate = 0",
    "[[at]]\nt = 1\nfault = { kind = 'gremlin' }": "at[0].fault.kind = 'gremlin'",
    "[[at]]\nt = 1\nfault = { kind = 'push', value = 1 }": "at[0].fault: seconds is missing",
    "[[at]]\nt = 1\nfault = { kind = 'slope', value = 2 }": "value = 2.0: must be rad, rising along world x, -0.7",
    "[[at]]\nt = 1\nfault = { kind = 'mass' }": "value is missing: kg in total",
    "[[at]]\nt = 1\nfault = { kind = 'bus_down', motor = 'left' }": "motor = 'left': bus_down concerns no motor",
    "[[at]]\nt = 1\nfault = { kind = 'power_off', value = 3 }": "value = 3.0: power_off takes none",
    "[[at]]\nt = 1\nfault = { kind = 'clear', seconds = 3 }": "clear does not end by itself",
    "[[expect]]\nfrom = 1": "expect[0]: expects nothing",
    "[[expect]]\nfrom = 3\nto = 2\nmode = 'idle'": "to = 2.0: must not be before from = 3.0",
    "[[expect]]\nto = 2\nwithin = 1\nmode = 'idle'": "give either `to` or `within`",
    "[[expect]]\nmode = 'asleep'": "expect[0].mode",
    "[[expect]]\nfrom = 5\nmode = 'idle'": "expect[0].from = 5.0: must be before seconds = 5.0",
    "this is no TOML": "not valid TOML",
}


@pytest.mark.parametrize(("wrong", "words"), WRONG.items(), ids=range(len(WRONG)))
def test_a_wrong_file_is_refused_with_the_key(wrong: str, words: str) -> None:
    seconds = "" if "seconds = -1" in wrong else "seconds = 5"
    with pytest.raises(ConfigError) as caught:
        parse_as(Scenario, f"robot = 'moby'\n{seconds}\n{wrong}", "a.toml")
    assert "a.toml: " in str(caught.value)
    assert words in str(caught.value)


UNKNOWN: tuple[tuple[dict[str, Any], str], ...] = (
    ({"command": ZERO | {"source": "mother"}}, "at[0].command.source = 'mother': there is teleop, autonomy"),
    ({"silence": "mother"}, "at[0].silence = 'mother'"),
    ({"fault": {"kind": "power_off", "motor": "hind"}}, "at[0].fault.motor = 'hind': there is left, right, platform"),
    ({"fault": {"kind": "bus_down", "bus": "can7"}}, "at[0].fault.bus = 'can7': there is can0"),
    ({"fault": {"kind": "friction", "motor": "platform", "value": 0.1}}, "'platform': there is left, right"),
    ({"fault": {"kind": "sensor_silent"}}, "at[0].fault.kind = 'sensor_silent': needs a [[sensor]] on a bus"),
)


@pytest.mark.parametrize(("at", "words"), UNKNOWN, ids=range(len(UNKNOWN)))
def test_a_name_that_is_not_on_the_robot_is_refused(at: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        run_scenario(scenario("moby", at=[{"t": 1.0} | at]))
    assert words in str(caught.value)


def test_a_joint_that_is_not_there_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"start\.joint\.hind = 'hind'"):
        run_scenario(scenario("moby", start={"joint": {"hind": 1.0}}))


CASTER: tuple[tuple[dict[str, Any], str], ...] = (
    ({"start": {"swivel": 0.5}}, "start.swivel = 0.5"),
    ({"at": [{"t": 1.0, "fault": {"kind": "impact", "value": 100.0, "seconds": 0.1}}]}, "at[0].fault.kind = 'impact'"),
)


@pytest.mark.parametrize(("parts", "words"), CASTER, ids=range(len(CASTER)))
def test_what_concerns_the_caster_needs_a_plant_with_one(parts: dict[str, Any], words: str) -> None:
    for robot, plant in (("moby", "simple"), ("omni4", "dynamics")):
        with pytest.raises(ConfigError) as caught:
            run_scenario(scenario(robot, plant=plant, **parts))
        needed = f"{words}: needs a caster: an offset_differential robot with plant = 'dynamics'"
        assert needed in str(caught.value)
    run_scenario(scenario("moby", plant="dynamics", **parts))


def test_a_plant_that_a_robot_does_not_have_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(PLANTS["omni"], PlantName.DYNAMICS)
    with pytest.raises(ConfigError, match="plant = 'dynamics': for a robot of kind omni there is 'simple'"):
        run_scenario(scenario("omni4", plant="dynamics"))
    with pytest.raises(ConfigError, match=r"plant = 'wood': must be .simple. or .dynamics."):
        parse_as(Scenario, "robot = 'moby'\nseconds = 5\nplant = 'wood'", "a.toml")


def test_a_wheel_without_inertia_cannot_slip() -> None:
    config = load(ROBOTS / "omni4.toml")[0]
    body = config.robot.body.model_copy(update={"joint_inertia": 0.0})
    weightless = config.model_copy(update={"robot": config.robot.model_copy(update={"body": body})})
    wanted = scenario(at=[{"t": 1.0, "fault": {"kind": "friction", "value": 0.1}}])
    with pytest.raises(ConfigError, match="joint_inertia above 0"):
        check_names(wanted, weightless, "a.toml")


# -- the drive --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUNDLED)
def test_a_robot_drives_as_commanded(name: str) -> None:
    seen = moments(scenario(name, at=[{"t": 0.2, "request": "stand_up"}, *DRIVE]))
    assert [moment.t for moment in seen] == pytest.approx([cycle * 0.004 for cycle in range(750)])
    assert seen[-1].outputs.mode is Mode.DRIVE
    balances = name == "odd_balancing"
    assert seen[-1].truth.twist.vx == pytest.approx(0.4, abs=0.05 if balances else 0.01)
    assert seen[-1].asked == (0.4, 0.0, 0.0)
    assert seen[0].asked is None


def test_the_caster_starts_where_it_is_told_and_gives_way() -> None:
    """Across the way it costs some sideways motion, against a start in which it trails."""
    ways = [
        moments(scenario("moby", at=list(DRIVE), plant="dynamics", start={"swivel": swivel}))[-1].truth.pose
        for swivel in (-1.5707963267948966, 1.2)
    ]
    assert ways[0].x == pytest.approx(0.7, abs=0.05)
    assert abs(ways[0].y) < 1e-6
    assert 1e-5 < abs(ways[1].y) < 1e-3


def test_commands_come_at_their_rate_with_sender_and_sequence() -> None:
    seen = moments(scenario(at=[{"t": 0.1, "command": AHEAD | {"rate": 10.0}}, {"t": 1.0, "silence": "teleop"}]))
    commands = [command for moment in seen for command in moment.inputs.commands]
    assert [command.sequence for command in commands] == list(range(9))
    assert [command.received_ns - FIRST_NS for command in commands] == [100_000_000 * k for k in range(1, 10)]
    assert {(command.sender, command.stamped) for command in commands} == {("scenario", False)}


@pytest.mark.parametrize("stamped", [False, True])
def test_what_was_sent_to_a_frozen_process_is_old_only_if_it_says_so(stamped: bool) -> None:
    pause = {"t": 1.0, "fault": {"kind": "loop_pause", "seconds": 0.5}}
    seen = moments(
        scenario(at=[{"t": 0.3, "command": ZERO | {"stamped": stamped}}, pause, {"t": 1.1, "silence": "teleop"}])
    )
    first = next(moment for moment in seen if moment.t > 1.0)
    (command,) = first.inputs.commands
    assert (first.inputs.now_ns - command.received_ns) / 1e9 == pytest.approx(0.42 if stamped else 0.0, abs=0.001)


def test_another_sender_takes_a_source_over_and_has_to_send_zero_first() -> None:
    at = [*DRIVE, {"t": 2.0, "command": AHEAD | {"sender": "stranger"}}]
    seen = moments(scenario(at=at, seconds=2.4))
    assert {command.sender for moment in seen for command in moment.inputs.commands} == {"scenario", "stranger"}
    assert seen[-1].outputs.mode is Mode.STOPPING


def test_a_setting_is_a_request_like_any_other() -> None:
    seen = moments(scenario(at=[*DRIVE, {"t": 0.7, "set": {"speed_override": 0.5}}], seconds=1.0))
    (request,) = [request for moment in seen for request in moment.inputs.requests]
    assert (request.kind, request.setting, request.value) == (RequestKind.SET, "speed_override", 0.5)
    assert [reply.ok for moment in seen for reply in moment.outputs.replies] == [True]


def test_requests_reach_the_core_with_what_they_say() -> None:
    asked = [{"t": 0.5, "request": "reference", "angle": 0.7}, {"t": 0.6, "request": "reference"}]
    seen = moments(scenario("moby", at=[*asked, {"t": 0.7, "request": "reset"}], seconds=1.0))
    requests = [request for moment in seen for request in moment.inputs.requests]
    assert [(request.kind, request.angle) for request in requests] == [
        (RequestKind.REFERENCE, 0.7),
        (RequestKind.REFERENCE, 0.0),
        (RequestKind.RESET, None),
    ]
    assert [(request.received_ns - FIRST_NS) / 1e9 for request in requests] == [0.5, 0.6, 0.7]
    assert len({request.id for request in requests} | {0}) == 4


def test_a_shutdown_ends_the_drive_when_the_robot_rests() -> None:
    result = run_scenario(scenario(at=[*DRIVE, {"t": 2.0, "request": "shutdown"}], seconds=20.0))
    assert 2.1 < result.seconds < 6.0


def test_a_restart_is_a_gap_and_commands_from_it_are_lost() -> None:
    seen = moments(scenario(at=[*DRIVE, {"t": 2.0, "request": "restart"}], seconds=4.0))
    gap = [(a.t, b.t) for a, b in pairwise(seen) if b.t - a.t > 0.005]
    assert gap == [(1.996, 2.0 + RESTART_S)]
    first = next(moment for moment in seen if moment.t >= 3.0)
    assert all(command.received_ns >= FIRST_NS + 3_000_000_000 - 1 for command in first.inputs.commands)
    assert first.outputs.mode is Mode.IDLE


def test_what_was_sent_while_nobody_listened_is_lost() -> None:
    at = [*DRIVE, {"t": 2.0, "request": "restart"}, {"t": 2.5, "silence": "teleop"}]
    seen = moments(scenario(at=at, seconds=4.0))
    assert not any(moment.inputs.commands for moment in seen if moment.t > 2.0)


def test_a_latched_emergency_stop_outlives_a_restart() -> None:
    at = [*DRIVE, {"t": 2.0, "request": "estop"}, {"t": 2.5, "request": "restart"}]
    broken = run_scenario(scenario(at=at, seconds=4.0, expect=[{"from": 2.1, "mode": "estop"}])).broken
    assert broken == ()


# -- alike every time -------------------------------------------------------------------------------------------------


def traced(path: Path, wanted: Scenario) -> bytes:
    config = load(ROBOTS / f"{wanted.robot}.toml")[0]
    with path.open("w", newline="") as file:
        run_scenario(wanted, config, watch=TraceWriter(file, config.robot.motor_names()).write)
    return path.read_bytes()


def test_the_same_file_gives_the_same_bytes(tmp_path: Path) -> None:
    wanted = parse_as(Scenario, TEXT, "a.toml")
    first, second = (traced(tmp_path / name, wanted) for name in ("one.csv", "two.csv"))
    assert first == second
    other = wanted.model_copy(update={"seed": 4})
    assert traced(tmp_path / "three.csv", other) != first, "chance comes from the seed"


def test_the_trace_has_a_row_per_cycle_and_says_what_is_unknown(tmp_path: Path) -> None:
    traced(tmp_path / "one.csv", scenario("moby", at=list(DRIVE)))
    with (tmp_path / "one.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == columns(("left", "right", "platform"))
    assert list(rows[0])[:5] == ["t", "mode", "vx_cmd", "vy_cmd", "wz_cmd"]
    assert list(rows[0])[11:17] == ["x_true", "y_true", "theta_true", "set.left", "set.right", "set.platform"]
    assert len(rows) == 750
    assert rows[0]["vx_cmd"] == rows[0]["set.left"] == "", "nobody commands, the motor is released"
    assert float(rows[-1]["vx_true"]) == pytest.approx(0.4, abs=0.01)
    assert float(rows[-1]["speed.left"]) == pytest.approx(4.0, abs=0.1)
    assert all(isfinite(float(row["torque.left"])) for row in rows)


@pytest.mark.parametrize("name", BUNDLED)
def test_it_is_recorded_and_verified_also_across_a_restart(name: str, tmp_path: Path) -> None:
    path = ROBOTS / f"{name}.toml"
    config, text = load(path)
    recording = SessionRecording(config, text, str(path), directory=tmp_path, started_wall_ns=1_790_000_000_000_000_000)
    at = [{"t": 0.2, "request": "stand_up"}, *DRIVE, {"t": 1.5, "request": "estop"}, {"t": 2.0, "request": "restart"}]
    result = run_scenario(scenario(name, at=at, seconds=4.0), config, recording=recording)
    recording.close()
    folders = sorted(tmp_path.iterdir())
    verdicts = [verify(open_session(folder)) for folder in folders]
    assert [verdict.exit_code for verdict in verdicts] == [0, 0]
    assert sum(verdict.cycles for verdict in verdicts) == result.cycles
    assert recording.session == folders[-1]


# -- expectations -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("expect", "broken"),
    [
        ({"from": 2.0, "mode": "drive"}, None),
        ({"from": 2.0, "mode": ["drive", "degraded"]}, None),
        ({"from": 0.1, "to": 1.0, "mode": "idle"}, "mode idle from 0.1 to 1 s: was starting at 0.300 s"),
        ({"from": 0.3, "within": 0.5, "mode": "drive"}, None),
        ({"from": 0.0, "within": 0.2, "mode": "drive"}, "mode drive between 0 and 0.2 s: never"),
        ({"max_speed": 0.45}, None),
        ({"max_speed": 0.1}, "at most 0.1 m/s from 0 to 3 s: was 0.10"),
        ({"from": 2.0, "min_speed": 0.3}, None),
        ({"from": 0.5, "min_speed": 0.3}, "at least 0.3 m/s from 0.5 to 3 s: was 0.000 m/s at 0.500 s"),
        ({"from": 0.5, "within": 2.0, "min_speed": 0.3}, None),
        ({"event": "mode_drive"}, None),
        ({"from": 1.0, "event": "mode_drive"}, "event mode_drive between 1 and 3 s: never"),
        ({"from": 0.0, "within": 1.0, "event": "mode_drive"}, None),
    ],
    ids=str,
)
def test_expectations(expect: dict[str, Any], broken: str | None) -> None:
    found = expecting(expect)
    if broken is None:
        assert found == ()
    else:
        assert len(found) == 1
        assert found[0].startswith(f"expect[0]: {broken}")


def test_a_window_without_a_cycle_is_no_success() -> None:
    at = [*DRIVE, {"t": 2.0, "request": "restart"}]
    (broken,) = expecting({"from": 2.2, "to": 2.8, "max_speed": 9.0}, at=at)
    assert broken == "expect[0]: at most 9 m/s from 2.2 to 2.8 s: no cycle ran then"


def test_each_broken_condition_is_told() -> None:
    assert len(expecting({"from": 2.0, "mode": "idle", "max_speed": 0.1, "event": "flood"}, {"mode": "fault"})) == 4


def test_what_happens_at_the_end_of_a_window_is_outside() -> None:
    at = [*DRIVE, {"t": 2.0, "request": "estop"}]
    assert expecting({"from": 1.5, "to": 2.0, "mode": "drive"}, {"from": 2.0, "mode": "estop"}, at=at) == ()


# -- those that come with the package ---------------------------------------------------------------------------------

SCENARIOS = sorted((ROBOTS.parent / "scenarios").glob("*.toml"))


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_bundled_scenarios(path: Path) -> None:
    assert run_scenario(load_scenario(path)).broken == ()


def test_there_are_bundled_scenarios() -> None:
    assert {path.stem for path in SCENARIOS} >= {"bus_dropout", "emergency_stop", "frozen_encoder", "impact", "slope"}


# -- the command ------------------------------------------------------------------------------------------------------


def test_the_command_tells_traces_and_records(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text(TEXT)
    plant = ("--plant", "dynamics")
    run = command_line(file, *plant, "--trace", tmp_path / "a.csv", "--out", tmp_path / "sessions", "--json")
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout.splitlines()[-1])
    assert list(told) == [
        "robot",
        "cycles",
        "modes",
        "events",
        "max_true_speed",
        "true_distance",
        "session",
        "broken",
    ]
    assert told["robot"] == "moby"
    assert told["modes"][0] == [0.0, "idle"]
    assert told["cycles"] == 1250
    assert told["broken"] == []
    assert told["true_distance"] > 0.3
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1 + told["cycles"]
    session = open_session(Path(told["session"]))
    assert session.header.plant == "dynamics"
    assert verify(session).exit_code == 0
    assert not run.stderr


def test_the_command_says_what_was_broken(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text("robot = 'moby'\nseconds = 1\n[[expect]]\nmode = 'drive'\n")
    run = command_line(file, "--robot", "omni4", "--json")
    assert run.returncode == 1
    told = json.loads(run.stdout.splitlines()[-1])
    assert (told["robot"], told["session"]) == ("omni4", None)
    assert told["broken"] == ["expect[0]: mode drive from 0 to 1 s: was idle at 0.000 s"]
    assert run.stderr.splitlines() == told["broken"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot = 'moby'\nseconds = 0", "seconds = 0"),
        ("robot = 'nobody'\nseconds = 1", "nobody"),
        ("robot = 'moby'\nseconds = 1\nat = [{ t = 0, silence = 'mother' }]", "at[0].silence = 'mother'"),
    ],
)
def test_the_command_refuses_a_bad_file(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    run = command_line(file)
    assert run.returncode == 78
    assert words in run.stderr
    assert run.stdout == ""


def test_a_session_that_did_not_reach_the_disk_is_no_success(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        (ROBOTS / "omni4.toml").read_text() + "[recording]\nmin_free = 10_000_000_000_000"
    )
    file = tmp_path / "a.toml"
    file.write_text("robot = 'mine.toml'\nseconds = 0.1\n")
    run = command_line(file, "--out", tmp_path / "sessions", "--json")
    assert run.returncode == 69
    assert "25 cycles are not in" in run.stderr


def test_a_missing_file_is_a_bad_file(tmp_path: Path) -> None:
    assert command_line(tmp_path / "none.toml").returncode == 78


def test_a_robot_file_is_looked_for_beside_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text((ROBOTS / "omni4.toml").read_text().replace('name = "omni4"', 'name = "mine"'))
    file = tmp_path / "a.toml"
    file.write_text("robot = 'mine.toml'\nseconds = 0.1\n")
    run = command_line(file, "--json")
    assert json.loads(run.stdout.splitlines()[-1])["robot"] == "mine"


def test_results_are_plain_data() -> None:
    result = run_scenario(scenario(at=list(DRIVE)))
    assert isinstance(result, Result)
    assert json.loads(json.dumps(result.as_json()))["broken"] == []
