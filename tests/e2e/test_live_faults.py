"""A robot that is broken while a person watches: only a simulated one has anything to be asked for it."""

import subprocess
import sys
from pathlib import Path

import zenoh

from gateway.edges import keys
from gateway.edges.messages import ResetAnswer, StateMessage, decode_reply
from gateway.types import Mode
from tests.e2e.robot_process import RobotProcess, in_mode
from tests.world import robot_text


def drivegate(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "gateway", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)


def test_a_simulated_robot_is_broken_and_the_recording_tells_it(tmp_path: Path, free_port: int) -> None:
    arguments = ("--simulate", "--fault", "frames_doubled@0.1+0.1=0.1")
    with RobotProcess("omni4", tmp_path, free_port, *arguments) as robot:
        there = ("--connect", robot.endpoint)
        robot.start()
        said = drivegate("fault", "omni4", "power_off:front_left", *there, "--json")
        assert said.returncode == 0, said.stderr
        assert said.stdout.strip() == '{"ok": true, "reason": null}'
        robot.stream(0.0, 0.0, 0.0, until=in_mode(Mode.DEGRADED))

        said = drivegate("fault", "omni4", "power_off:nobody", *there)
        assert said.returncode == 1
        assert "refused: at[0].fault.motor = 'nobody': there is front_left" in said.stderr

        texts: list[str] = []

        def told(_: StateMessage) -> bool:
            texts.extend(event.text for event in robot.client.events() if event.code == "mark")
            return any("power_off:front_left" in text for text in texts)

        robot.await_state(told)  # a mark waits until a second after the last
        (reply,) = asked(robot, f"omni4/{keys.FAULT}", b"at = [")
        assert reply is not None
        assert not reply.ok
        for wildcard in ("omni4/sim/*", "omni4/sim/**", "*/sim/fault"):
            (reply,) = asked(robot, wildcard, b'at = [{ t = 0, fault = { kind = "bus_down" } }]')
            assert reply == (False, f"{keys.FAULT} must be asked by its exact key, without wildcards")
        assert robot.end() == 0
        verdict = robot.verify()
        assert verdict.identical
    assert "simulated: frames_doubled+0.1=0.1" in robot.log.read_text()


def test_a_robot_on_a_real_interface_has_nothing_to_be_asked_for_it(tmp_path: Path, free_port: int) -> None:
    """Whatever it drives on: here an interface of python-can on which nobody answers."""
    file = tmp_path / "omni4.toml"
    text = robot_text("omni4").replace('interface = "socketcan"', 'interface = "virtual"')
    file.write_text(text, encoding="utf-8")
    with RobotProcess("omni4", tmp_path, free_port, "--log-level", "info", file=file) as robot:
        assert robot.client.give_faults('at = [{ t = 0, fault = { kind = "power_off" } }]') is None
        for key in (f"omni4/{keys.FAULT}", "omni4/sim/**"):
            assert asked(robot, key, b"at = []") == []
        said = drivegate("fault", "omni4", "power_off", "--connect", robot.endpoint)
        assert said.returncode == 1
        assert f"omni4 is no simulated robot (it has no key {keys.FAULT})" in said.stderr
        assert robot.end() == 0
    for option in (("--fault", "power_off"), ("--script", "faults.toml")):
        said = drivegate("run", str(file), *option)
        assert said.returncode == 2
        assert "belongs to --simulate" in " ".join(said.stderr.split())


def asked(robot: RobotProcess, key: str, payload: bytes) -> list[ResetAnswer | None]:
    """Every reply to a get on this key."""
    replies = robot.client._session.get(key, payload=payload, timeout=3.0, target=zenoh.QueryTarget.ALL)
    return [decode_reply(reply.ok.payload.to_bytes()) for reply in replies if reply.ok is not None]
