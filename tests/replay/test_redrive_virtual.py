"""Recorded drives once more in virtual time: every bundled robot drives alike, on however many buses."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.types import ZERO_TWIST, Mode, RequestKind, SensorKind, SensorSample, Twist
from replay.compare.verify import verify
from replay.drive import redrive_virtual
from replay.drive.recorded_drive import LEAD_NS, RedriveError, asked
from replay.drive.redrive import channel_of_each
from replay.drive.redrive_virtual import redrive_virtually
from replay.sessions.reader import Session, open_session
from tests.recordings import STARTED_NS, write_drive
from tests.redriven import on_two_buses, short_drive
from tests.world import BUNDLED, World

EACH_KIND = ("moby", "omni4", "mecanum4", "odd")


def redriven(session: Session, out: Path) -> redrive_virtual.Redriven:
    return redrive_virtually(session, out=out, started_wall_ns=STARTED_NS)


def given(session: Session) -> list[tuple[int, object]]:
    """What was asked and when, but for numbers that are counted anew."""
    return [(ns, one._replace(received_ns=0)) for ns, one in asked(session)]


@pytest.mark.parametrize(
    ("name", "edit"), [*((name, str) for name in BUNDLED), *((name, on_two_buses) for name in EACH_KIND)]
)
def test_every_robot_drives_alike(name: str, edit: Callable[[str], str], tmp_path: Path) -> None:
    session = short_drive(name, tmp_path / "first", edit=edit)
    found = redriven(session, tmp_path / "second")
    assert found.comparison.reasons == ()
    assert found.comparison.path_m > 0.2
    assert found.comparison.modes_redriven == found.comparison.modes_recorded
    assert "drive" in found.comparison.modes_recorded
    again = open_session(Path(found.comparison.session))
    assert verify(again).identical
    buses = {frame.bus for _, outputs in again.cycles() for frame in outputs.frames}
    assert buses == ({"can0"} if edit is str else {"front", "rear"})


def test_everything_is_given_at_its_time(tmp_path: Path) -> None:
    session = short_drive("omni4", tmp_path / "first")
    again = open_session(Path(redriven(session, tmp_path / "second").comparison.session))
    before = given(session)
    assert {type(one).__name__ for _, one in before} == {"TwistCommand", "Request"}
    assert given(again)[: len(before)] == before
    (end,) = given(again)[len(before) :]
    assert getattr(end[1], "kind", None) is RequestKind.SHUTDOWN


def test_what_broke_then_and_not_now_is_a_difference(tmp_path: Path) -> None:
    world = World("omni4")
    world.start()
    world.run(0.5, Twist(0.5, 0.0, 0.0))
    world.bus.robot.devices["front_left"].power_off()
    world.run(1.0, Twist(0.5, 0.0, 0.0))
    found = redriven(open_session(write_drive(tmp_path / "first", world)), tmp_path / "second")
    assert any(reason.startswith("modes: ") and "degraded" in reason for reason in found.comparison.reasons)


def test_a_shutdown_that_was_recorded_ends_it(tmp_path: Path) -> None:
    world = World("omni4")
    world.start()
    world.run(0.5, Twist(0.3, 0.0, 0.0))
    world.request(RequestKind.SHUTDOWN)
    world.run(1.5, until=lambda outputs: outputs.finished)
    session = open_session(write_drive(tmp_path / "first", world))
    again = open_session(Path(redriven(session, tmp_path / "second").comparison.session))
    kinds = [request.kind for inputs, _ in again.cycles() for request in inputs.requests]
    assert kinds == [RequestKind.SHUTDOWN]


def wire_by_zenoh(text: str) -> str:
    return re.sub(r'(name = "wire"\nkind = "range"\ntimeout = 0.05)\n(.+\n){4}', r"\1\n", text)


def test_what_sensors_told_by_zenoh_is_told_again_before_the_first_command_too(tmp_path: Path) -> None:
    """Else the width would not be known in time for it."""
    world = World("odd", edit=wire_by_zenoh)
    assert [sensor.kind for sensor in world.config.sensor if sensor.bus is None] == [SensorKind.RANGE]

    def wire(now_ns: int) -> list[SensorSample]:
        return [SensorSample("wire", (world.bus.robot.scene.width,), None, now_ns)]

    world.run(1.0, sensed=wire)
    world.run(1.0, ZERO_TWIST, sensed=wire, until=lambda outputs: outputs.mode is Mode.DRIVE)
    world.run(1.0, Twist(0.3, 0.0, 0.3), sensed=wire)
    world.run(1.0, ZERO_TWIST, sensed=wire)
    session = open_session(write_drive(tmp_path / "first", world))
    assert min(ns for ns, one in asked(session) if isinstance(one, SensorSample)) < LEAD_NS
    found = redriven(session, tmp_path / "second").comparison
    assert found.reasons == ()
    assert "drive" in found.modes_redriven


def test_nothing_commanded_is_nothing_to_repeat(tmp_path: Path) -> None:
    world = World("moby")
    world.run(0.3)
    session = open_session(write_drive(tmp_path, world))
    with pytest.raises(RedriveError, match="nothing was commanded"):
        redriven(session, tmp_path)


def test_motors_that_do_not_answer_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = short_drive("moby", tmp_path)
    monkeypatch.setattr(redrive_virtual, "READY_S", 0.004)
    with pytest.raises(RedriveError, match="does not get ready: left: never heard"):
        redriven(session, tmp_path)


# the command


def run(*words: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "run", *map(str, words)])


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return short_drive("moby", tmp_path_factory.mktemp("moby")).path


def test_the_command_in_virtual_time(session: Path, tmp_path: Path) -> None:
    done = run(session, "--speed", "max", "--out", tmp_path, "--json")
    told = json.loads(done.stdout)
    assert (done.exit_code, told["similar"], told["complete"]) == (0, True, True)
    assert told["realtime_ratio"] > 0.0
    assert Path(told["session"]).parent == tmp_path
    done = run(session, "--speed", "max", "--out", tmp_path)
    assert "alike" in done.stdout
    assert "in virtual time, " in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--speed max to drive in virtual time"),
        (("--speed", "2"), "--speed 2: say on which virtual CAN interface"),
        (("--speed", "1"), "--speed 1: say on which virtual CAN interface"),
        (("--speed", "2", "--channel", "vcan0"), "--speed 2: a live service on a CAN interface keeps real time"),
        (("--speed", "max", "--channel", "vcan0"), "--speed max: a live service on a CAN interface keeps real time"),
        (("--speed", "max", "--tick", "5"), "--tick belongs to --channel"),
        (("--channel", "rear=vcan0"), "--channel rear=vcan0: this robot has no bus rear, it has bus can0"),
        (("--channel", "can0=can0"), "can0 may lead to motors"),
        (("--channel", "can0=vcan77"), "no CAN interface vcan77"),
    ],
)
def test_what_does_not_go_together_is_said(session: Path, tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    done = run(session, *words, "--out", tmp_path, "--json")
    assert done.exit_code == 2
    assert said in json.loads(done.stdout)["problem"]
    assert list(tmp_path.iterdir()) == []


def test_each_bus_gets_its_channel() -> None:
    assert channel_of_each(["can0"], ["vcan3"]) == {"can0": "vcan3"}
    assert channel_of_each(["can0"], ["can0=vcan3"]) == {"can0": "vcan3"}
    assert channel_of_each(["front", "rear"], ["rear=vcan0", "front=vcan1"]) == {"front": "vcan1", "rear": "vcan0"}


ALL = "--channel front=vcan0 --channel rear=vcan1"


@pytest.mark.parametrize(
    ("channels", "said"),
    [
        (["vcan0"], f"--channel vcan0: this robot has buses front, rear, each needs its own: {ALL}"),
        (["front="], f"--channel front=: this robot has buses front, rear, each needs its own: {ALL}"),
        (["front=vcan0"], f"no channel for bus rear: {ALL}"),
        (["left=vcan0"], "--channel left=vcan0: this robot has no bus left, it has buses front, rear"),
        (["front=vcan0", "front=vcan1"], "--channel front=vcan1: bus front has vcan0 already"),
        (
            ["front=vcan0", "rear=vcan0"],
            f"--channel rear=vcan0: vcan0 is that of bus front; each bus needs its own: {ALL}",
        ),
    ],
)
def test_a_bus_without_a_channel_of_its_own_is_said(channels: list[str], said: str) -> None:
    with pytest.raises(RedriveError) as caught:
        channel_of_each(["front", "rear"], channels)
    assert str(caught.value) == said
