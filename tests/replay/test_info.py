"""`drivegate replay info` tells what a session is without running it, and tells the same as every cycle read does."""

import json
from itertools import groupby
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.core.engine import Engine
from gateway.recording.disk import segment_path
from gateway.recording.header import git_commit
from gateway.types import Level, RequestKind, Twist
from replay.sessions.reader import open_session
from replay.sessions.summary import summary
from tests.recordings import STARTED_NS, write, write_drive
from tests.world import World

BATCH = 60
OLD = Path(__file__).parent.parent / "sessions"


@pytest.fixture(scope="module")
def world() -> World:
    driven = World("moby", rate_hz=100.0)
    driven.start()
    driven.run(1.0, Twist(0.3, 0.1, 0.2))
    driven.request(RequestKind.ESTOP)
    driven.run(1.0, Twist(0.3, 0.1, 0.2))
    return driven


@pytest.fixture(scope="module")
def recorded(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("s"), world, batch=BATCH, snapshots=True, segment_bytes=60_000)


def asked(*arguments: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "info", *map(str, arguments)])


def test_it_tells_what_the_cycles_say(recorded: Path, world: World) -> None:
    found = summary(open_session(recorded))
    records = world.records
    assert (found.robot, found.cycles, found.first_cycle, found.last_cycle) == (
        "moby",
        len(records),
        0,
        len(records) - 1,
    )
    assert found.seconds == pytest.approx((records[-1][0].now_ns - records[0][0].now_ns) * 1e-9)
    assert found.frames_received == sum(len(inputs.frames) for inputs, _ in records)
    assert found.frames_sent == sum(len(outputs.frames) for _, outputs in records)
    assert [stay.mode for stay in found.modes] == [mode.value for mode, _ in groupby(out.mode for _, out in records)]
    assert sum(stay.seconds for stay in found.modes) == pytest.approx(found.seconds, abs=1e-4)
    serious = [event for event in world.events if event.level is not Level.INFO]
    assert sum(fault.times for fault in found.faults) == len(serious) > 0
    assert {fault.code for fault in found.faults} == {event.code for event in serious}
    assert found.complete
    assert not found.gaps
    assert [segment.bytes for segment in found.segments] == [p.stat().st_size for p in sorted(recorded.glob("*.rrd"))]


@pytest.mark.parametrize("name", ["v1-moby", "v1-omni4"])
def test_recordings_of_schema_1(name: str) -> None:
    found = summary(open_session(OLD / name))
    assert found.schema == 1
    assert found.cycles == len(list(open_session(OLD / name).cycles())) > 0
    assert "drive" in {stay.mode for stay in found.modes}


@pytest.mark.pure_python
def test_nothing_is_run(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*_: object) -> None:
        message = "the core was run"
        raise AssertionError(message)

    monkeypatch.setattr(Engine, "step", run)
    assert asked(recorded, "--json").exit_code == 0


def test_the_command(recorded: Path) -> None:
    result = asked(recorded, "--json")
    told = json.loads(result.stdout.splitlines()[-1])
    assert result.exit_code == 0
    assert told["complete"]
    assert told["commit"] == git_commit(), "none where there is no checkout"
    assert told["began"] == "2026-09-21T14:29:55.123+00:00"
    assert STARTED_NS // 10**9 == 1_790_000_000  # 14:13:20; the first cycle is 995 s after it, by its own clock
    assert asked(recorded).exit_code == 0


def test_a_gap_and_a_verdict(recorded: Path, tmp_path: Path) -> None:
    for number in (1, 3):
        source = segment_path(recorded, number)
        (tmp_path / source.name).write_bytes(source.read_bytes())
    result = asked(tmp_path, "--json", "--verify")
    told = json.loads(result.stdout.splitlines()[-1])
    assert result.exit_code == 3
    assert not told["complete"]
    assert told["gaps"][0] == {"first_cycle": BATCH, "last_cycle": 2 * BATCH - 1, "reason": "not in the recording"}
    assert (told["verdict"]["exit_code"], told["verdict"]["unseen"]) == (3, 0)
    assert asked(tmp_path).exit_code == 3


def test_a_session_without_a_cycle(tmp_path: Path) -> None:
    result = asked(write(tmp_path, []), "--json")
    told = json.loads(result.stdout.splitlines()[-1])
    assert result.exit_code == 2
    assert (told["began"], told["cycles"], told["modes"]) == (None, 0, [])


def test_what_is_no_session(tmp_path: Path) -> None:
    result = asked(tmp_path, "--json")
    assert result.exit_code == 2
    assert "not a session" in json.loads(result.stdout.splitlines()[-1])["problem"]
