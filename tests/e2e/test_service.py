"""End to end on loopback: the service in one process, commanders in others, the session read back."""

import json
import os
import pty
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from gateway.edges.zenoh_session import open_zenoh
from gateway.types import Mode
from tests.e2e.robot_process import RobotProcess, faster_than, in_mode, kept_out, standing
from tests.world import NAMES

both = pytest.mark.parametrize("name", NAMES)
ZERO_FIRST = "has to send zero first"


@both
def test_drive_silence_stop_and_verify(name: str, tmp_path: Path, free_port: int) -> None:
    with RobotProcess(name, tmp_path, free_port) as robot:
        client = robot.client
        robot.start()
        state = robot.stream(0.3, 0.0, 0.0, until=faster_than(0.28))
        assert state.status.winner == "teleop"
        assert all(motor.measured is not None for motor in state.status.motors)

        robot.await_state(in_mode(Mode.IDLE))
        assert robot.stream(0.3, 0.0, 0.0, until=kept_out("teleop", ZERO_FIRST)).status.mode is Mode.IDLE

        robot.start()
        robot.stream(0.0, 0.0, 0.0, until=lambda state: state.status.winner == "autonomy", source="autonomy")
        robot.stream(0.3, 0.0, 0.0, until=faster_than(0.2), source="autonomy")
        state = robot.stream(0.0, 0.0, 0.4, until=lambda state: state.status.winner == "teleop")
        outranked = {source.name: source.reason for source in state.status.sources}["autonomy"]
        assert outranked is not None

        assert client.stop()
        robot.await_state(in_mode(Mode.ESTOP))
        robot.await_state(standing)
        robot.stream(0.3, 0.0, 0.0, until=kept_out("teleop", ZERO_FIRST))
        answer = client.reset()
        assert not answer.ok
        assert answer.reason == "teleop commands motion; commands must be zero"
        robot.await_state(kept_out("teleop", "silent for longer than its timeout of 0.3 s"))
        assert client.reset().ok
        robot.await_state(in_mode(Mode.IDLE))

        odometry, truth = client.odometry(), client.truth()
        assert odometry is not None
        assert truth is not None
        assert odometry.x == pytest.approx(truth.x, abs=0.02)
        assert odometry.y == pytest.approx(truth.y, abs=0.02)

        robot.start()
        robot.stream(0.3, 0.0, 0.0, until=faster_than(0.2))
        assert robot.end() == 0
        verdict = robot.verify()
        assert verdict.problem is None
        assert verdict.first_difference is None
        assert verdict.identical
        assert verdict.frames >= verdict.cycles


BAD = [
    ("omni4/cmd/twist/teleop", b"", "refused_malformed"),
    ("omni4/cmd/twist/teleop", b"\xff\xfe{", "refused_malformed"),
    ("omni4/cmd/twist/teleop", b'{"vx": 1}', "refused_malformed"),
    ("omni4/cmd/twist/teleop", b'{"vx": NaN, "vy": 0, "wz": 0}', "refused_not_finite"),
    ("omni4/cmd/twist/teleop", b'{"vx": 500, "vy": 0, "wz": 0}', "refused_out_of_range"),
    ("omni4/cmd/twist/teleop", b'{"vx": 0, "vy": 0, "wz": 0, "frame": "map"}', "refused_wrong_frame"),
    ("omni4/cmd/twist/teleop", b"9" * 5000, "refused_too_long"),
    ("omni4/cmd/twist/teleop", None, "refused_not_a_put"),
    ("omni4/cmd/twist/stranger", b'{"vx": 0, "vy": 0, "wz": 0}', "refused_unknown_source"),
    ("omni4/cmd/twist/*", b'{"vx": 0, "vy": 0, "wz": 0}', "refused_key_not_exact"),
]


def test_bad_payloads_are_refused_with_a_reason_and_move_nothing(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("omni4", tmp_path, free_port) as robot:
        robot.await_state(lambda state: state.status.reason == "waiting for a fresh zero command")
        session = open_zenoh(listen=[], connect=[robot.endpoint], max_message_size=65536)
        for key, payload, code in BAD:
            for _ in range(50):
                if payload is None:
                    session.delete(key)
                else:
                    session.put(key, payload)
                seen = robot.client.state()
                robot.client.wait_for_state(lambda state, seen=seen: state is not seen, 1.0)  # type: ignore[misc]
                if code in {event.code for event in robot.client.events()}:
                    break
            else:
                pytest.fail(f"{payload!r} on {key} was not told as {code}")
        session.close()  # type: ignore[no-untyped-call]
        state = robot.client.status()
        assert state is not None
        assert state.status.mode is Mode.IDLE
        assert state.status.refused >= len(BAD)


def test_a_killed_commander_leaves_the_robot_at_rest(tmp_path: Path, free_port: int) -> None:
    with RobotProcess("moby", tmp_path, free_port) as robot:
        command = [sys.executable, "-m", "gateway", "send", "moby", "--vx", "0.4", "--for", "60"]
        commander = subprocess.Popen([*command, "--connect", robot.endpoint], stdout=subprocess.DEVNULL)
        try:
            robot.await_state(faster_than(0.3), timeout=40.0)
        finally:
            commander.kill()
            commander.wait(10.0)
        robot.await_state(in_mode(Mode.STOPPING))
        robot.await_state(in_mode(Mode.IDLE))
        robot.await_state(standing)


def test_commands_for_scripts(tmp_path: Path, free_port: int) -> None:
    """`send`, `stop`, `watch` against a running robot."""
    with RobotProcess("omni4", tmp_path, free_port) as robot:

        def drivegate(*arguments: str) -> subprocess.CompletedProcess[str]:
            command = [sys.executable, "-m", "gateway", *arguments, "--connect", robot.endpoint]
            return subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)

        sent = drivegate("send", "omni4", "--vy", "0.3", "--for", "1")
        assert sent.returncode == 0, sent.stderr
        odometry = robot.client.odometry()
        assert odometry is not None
        assert odometry.y > 0.15
        wrong = drivegate("send", "omni4", "--vx", "100")
        assert (wrong.returncode, wrong.stderr.strip()) == (1, "vx = 100.0: must be a number from -20 to 20 m/s")
        ghost = drivegate("send", "omni4", "--source", "ghost", "--json")
        assert ghost.returncode == 1
        reason = json.loads(ghost.stdout.splitlines()[-1])["reason"]
        assert reason == "does not start: no source ghost: the sources are teleop, autonomy"
        turned = drivegate("reference", "omni4", "--angle", "7")
        assert (turned.returncode, turned.stderr.strip()) == (1, "angle = 7.0: must be a number from -6.3 to 6.3 rad")
        slower = drivegate("set", "omni4", "speed_override", "0.5", "--json")
        assert (slower.returncode, json.loads(slower.stdout)) == (0, {"ok": True, "reason": None})
        faster = drivegate("set", "omni4", "speed_override", "2")
        assert faster.returncode == 1
        assert "refused: speed_override = 2: must be 0.05 to 1 of limits.velocity" in faster.stderr.replace("\n", " ")
        held = drivegate("send", "omni4", "--vx", "2", "--for", "0.5", "--json")
        assert json.loads(held.stdout.splitlines()[-1])["limits_active"] == ["speed_override", "acceleration"]
        stopped = drivegate("stop", "omni4", "--json")
        assert stopped.returncode == 0, stopped.stderr
        assert json.loads(stopped.stdout)["ok"] is True
        assert "estop" in drivegate("watch", "omni4", "--once").stdout
        watched = json.loads(drivegate("watch", "omni4", "--json").stdout.splitlines()[-1])
        assert {one["name"]: one["value"] for one in watched["settings"]}["speed_override"] == 0.5
        assert (watched["mode"], [source["name"] for source in watched["sources"]]) == ("estop", ["teleop", "autonomy"])
        latched = drivegate("send", "omni4", "--vx", "0.3")
        assert latched.returncode == 1
        assert "does not start: mode estop: emergency stop: needs a reset" in latched.stderr
        robot.await_state(lambda state: state.status.winner is None)
        released = drivegate("stop", "omni4", "--reset", "--json")
        assert json.loads(released.stdout.splitlines()[-1]) == {"ok": True, "reason": None}


def held(robot: RobotProcess, keyboard: int, key: bytes) -> bool:
    """Whether it drives while a key is held for 2 s; let go for 1 s else: after a late look a press anew is wanted."""
    for _ in range(40):
        os.write(keyboard, key)
        if robot.client.wait_for_state(faster_than(0.25), 0.05):
            return True
    return robot.client.wait_for_state(faster_than(0.25), 1.0) is not None


def test_keyboard_teleoperation(tmp_path: Path, free_port: int) -> None:
    """A held key drives (terminals repeat it), its release stops, x ends; the terminal is given back as it was."""
    with RobotProcess("omni4", tmp_path, free_port) as robot:
        keyboard, terminal = pty.openpty()
        before = termios.tcgetattr(terminal)
        command = [sys.executable, "-m", "gateway", "drive", "omni4", "--connect", robot.endpoint]
        teleop = subprocess.Popen(command, stdin=terminal, stdout=subprocess.DEVNULL)
        try:
            robot.await_state(in_mode(Mode.DRIVE), timeout=40.0)
            assert any(held(robot, keyboard, b"w") for _ in range(10)), robot.client.state()
            state = robot.await_state(lambda state: state.status.standing is True)
            assert state.status.mode is Mode.DRIVE, "released, not silent"
            os.write(keyboard, b"www!")  # one read
            robot.await_state(in_mode(Mode.ESTOP))
            os.write(keyboard, b"x")
            assert teleop.wait(10.0) == 0
        finally:
            teleop.kill()
            teleop.wait(10.0)
            after = termios.tcgetattr(terminal)
            os.close(keyboard)
            os.close(terminal)
        assert after == before


def test_a_robot_that_balances_stands_up_when_it_is_asked(tmp_path: Path, free_port: int) -> None:
    """How long it stays up depends on the computer here, which may be late; in virtual time see test_balance.py."""
    name = "odd_balancing"
    with RobotProcess(name, tmp_path, free_port) as robot:

        def stand(way: str) -> dict[str, object]:
            command = [sys.executable, "-m", "gateway", "stand", name, way, "--connect", robot.endpoint, "--json"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
            answer = json.loads(done.stdout.splitlines()[-1])
            assert (done.returncode == 0) == answer["ok"]
            return dict(answer)

        down = "it is down: hold it upright and ask it to stand up"
        robot.stream(0.0, 0.0, 0.0, until=lambda state: state.status.reason == down)
        assert stand("down") == {"ok": False, "reason": "it does not stand"}
        assert stand("up") == {"ok": True, "reason": None}
        robot.stream(0.0, 0.0, 0.0, until=in_mode(Mode.DRIVE))
        robot.await_state(in_mode(Mode.STOPPING, Mode.FAULT, Mode.IDLE))
        robot.client.let_down()
        robot.await_state(in_mode(Mode.IDLE))
    verdict = robot.verify()
    assert (verdict.exit_code, verdict.identical) == (0, True)
