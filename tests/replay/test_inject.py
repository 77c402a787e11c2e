"""Faults in recorded drives: the same drive without any, the laws watched, and violations found and made short."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.config import ConfigError, parse
from gateway.types import Mode
from replay.compare.likeness import moments
from replay.drive.scenario import Given
from replay.drive.script import Script, in_words, script_of
from replay.inject.campaign import campaign
from replay.inject.injection import Recorded, inject, recorded
from replay.inject.kept import keep, still_broken
from replay.sessions.reader import open_session
from tests.test_laws_can_fail import ROWS, Removed
from tests.world import robot_text

SESSIONS = Path(__file__).parents[1] / "sessions"
OMNI4 = SESSIONS / "v1-omni4"


def drive() -> Recorded:
    return recorded(open_session(OMNI4))


def broken(*words: str) -> Script:
    return script_of([in_words(one) for one in words])


def test_without_a_fault_it_is_the_same_drive() -> None:
    found = inject(drive(), Script())
    modes = [moment.mode for moment in moments(open_session(OMNI4))]
    seen = [mode for place, mode in enumerate(modes) if place == 0 or modes[place - 1] is not mode]
    assert [mode for _, mode in found.result.modes] == [Mode.IDLE, *seen]  # those are counted from the start on
    assert found.broken == []
    assert found.result.true_distance > 1.0


def test_what_breaks_shows() -> None:
    sources = {command.source for command in drive().given.commands}
    whole, cut = inject(drive(), Script()), inject(drive(), broken(*[f"silence@2:{source}" for source in sources]))
    assert cut.result.true_distance < 0.7 * whole.result.true_distance
    lost = inject(drive(), broken("power_off@2:front_left"))
    assert Mode.DEGRADED in [mode for _, mode in lost.result.modes]
    stopped = inject(drive(), broken("estop@2", "frames_lost@1+0.5=0.3"))
    assert stopped.result.modes[-1][1] is Mode.ESTOP


@pytest.mark.parametrize(
    ("words", "entry"),
    [
        ("power_off@5:front_left", {"t": 5.0, "fault": {"kind": "power_off", "motor": "front_left"}}),
        ("frames_lost@3+0.5=0.3", {"t": 3.0, "fault": {"kind": "frames_lost", "seconds": 0.5, "value": 0.3}}),
        ("bus_down@1.5+0.2:can0", {"t": 1.5, "fault": {"kind": "bus_down", "seconds": 0.2, "bus": "can0"}}),
        ("sensor_jump@1:imu=-0.1", {"t": 1.0, "fault": {"kind": "sensor_jump", "sensor": "imu", "value": -0.1}}),
        ("silence@2:teleop", {"t": 2.0, "silence": "teleop"}),
        ("estop@4", {"t": 4.0, "request": "estop"}),
    ],
)
def test_a_fault_in_words(words: str, entry: dict[str, object]) -> None:
    assert in_words(words) == entry


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("power_off", "must be KIND@SECONDS"),
        ("power_off@1..2:front_left", "'1..2' is no number"),
        ("nonsense@1", "request"),
        ("frames_lost@1=3", "value = 3.0: must be a fraction, 0 to 1"),
        ("power_off@1:wheel", "at[0].fault.motor = 'wheel': there is front_left"),
        ("power_off@100:front_left", "at t = 100: the session is 5.9"),
        ("silence@1", "silence"),
    ],
)
def test_a_fault_in_wrong_words(words: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        inject(drive(), broken(words))
    assert said in str(caught.value)


def commanded(row: Removed) -> Recorded:
    """A drive of that robot in which somebody commands, and nothing breaks: what a campaign begins with."""
    text = row.edit(robot_text(row.robot))
    return Recorded(row.robot, text, parse(text, row.robot), Given(), 12.0, drive().plant)


QUICK = [row for row in ROWS if row.remove.__name__ in {"admit_without_zero", "command_everyone", "stop_at_once"}]


@pytest.mark.pure_python
@pytest.mark.parametrize("row", QUICK, ids=lambda row: row.remove.__name__)
def test_a_campaign_finds_a_rule_that_is_gone_and_writes_a_test(
    row: Removed, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with monkeypatch.context() as patch:
        row.remove(patch)
        found = campaign([commanded(row)], cycles=60_000, seed=5).found
        assert found is not None
        assert found.law == row.law
        assert len(found.shrunk.scenario.at) <= 6
        folder = keep(found, tmp_path)
        assert [words.split(":")[0] for words in still_broken(folder)] == [row.law]
    assert still_broken(folder) == [], "with the rule it is mended"
    (test,) = folder.glob("test_*.py")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", str(test)], capture_output=True, text=True, check=False
    )
    assert "1 passed" in done.stdout


def test_a_campaign_over_recorded_sessions_finds_nothing_and_is_the_same_again() -> None:
    drives = [recorded(open_session(path)) for path in sorted(SESSIONS.glob("v*"))]
    told: list[int] = []
    found = campaign(drives, cycles=4000, seed=7, told=told.append)
    assert found.found is None
    assert found.cycles == sum(told) >= 4000
    assert found == campaign(drives, cycles=4000, seed=7)


def answer(*arguments: str) -> tuple[int, dict[str, object]]:
    result = CliRunner().invoke(build("replay"), ["replay", *arguments, "--json"])
    return result.exit_code, json.loads(result.stdout.splitlines()[-1])


def test_by_command(tmp_path: Path) -> None:
    script = tmp_path / "script.toml"
    script.write_text('[[at]]\nt = 2.0\nfault = { kind = "encoder_frozen", motor = "rear_left" }\n')
    code, document = answer("inject", str(OMNI4), str(script), "--fault", "estop@4", "--out", str(tmp_path))
    assert code == 0
    assert document["broken"] == []
    assert open_session(Path(str(document["session"]))).complete
    code, document = answer("campaign", str(SESSIONS), "--cycles", "500", "--out", str(tmp_path / "none"))
    assert (code, document["found"], document["test"]) == (0, None, None)
    assert not (tmp_path / "none").exists()


def test_what_cannot_be_driven_again_is_told(tmp_path: Path) -> None:
    result = CliRunner().invoke(build("replay"), ["replay", "inject", str(tmp_path)])
    assert result.exit_code == 2
    result = CliRunner().invoke(build("replay"), ["replay", "campaign", str(tmp_path)])
    assert result.exit_code == 2
