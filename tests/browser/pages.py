"""Sessions of every kind that a report must show, each with its page."""

import json
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.config import load
from gateway.recording.packets import Record
from gateway.robot_files import find
from gateway.types import Event, Level
from replay.drive.recording import SessionRecording
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import load_scenario
from tests.corpus import FOLDER, STARTED_WALL_NS
from tests.drives import drive
from tests.recordings import write

SCENARIOS = Path(__file__).parent.parent.parent / "deploy" / "scenarios"
OLD = Path(__file__).parent.parent / "sessions"
HOSTILE = "<script>document.title='taken'</script><img src=x onerror=alert(1)>\"'&amp;"
KINDS = {"moby": 0, "omni4": 0, "odd": 0, "slip": 0, "incomplete": 3, "different": 1, "old": 1}  # exit codes of verify


class Told(NamedTuple):
    """A page, and what the other commands say of the same session."""

    name: str
    page: Path
    report: dict[str, Any]
    info: dict[str, Any]
    verdict: dict[str, Any]
    trace: list[dict[str, str]]


def reports(directory: Path, names: Iterable[str] = KINDS) -> Iterator[Told]:
    """One of each of these kinds."""
    for name in names:
        session, page = _session(name, directory / name), directory / f"{name}.html"
        yield Told(
            name=name,
            page=page,
            report=_json("report", session, "-o", page, "--json"),
            info=_json("info", session, "--json"),
            verdict=_json("verify", session, "--json"),
            trace=_trace(session),
        )


def _session(name: str, directory: Path) -> Path:
    """Those of the corpus have a motor that is lost and an emergency stop."""
    match name:
        case "moby" | "omni4" | "odd":
            return FOLDER / name
        case "slip":
            return _driven("oil_patch", directory)
        case "incomplete":
            return _cut(FOLDER / "omni4", directory)
        case "different":
            return write(directory, list(_hostile()))
        case _:
            return OLD / "v1-moby"


def _driven(name: str, directory: Path) -> Path:
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    path = find(scenario.robot)
    config, text = load(path)
    recording = SessionRecording(
        config, text, path.name, directory=directory, started_wall_ns=STARTED_WALL_NS, plant=scenario.plant
    )
    run_scenario(scenario, config, recording=recording)
    recording.close()
    return recording.session


def _cut(session: Path, directory: Path) -> Path:
    """As a machine leaves it whose power goes: without its end."""
    shutil.copytree(session, directory)
    segment = max(directory.glob("*.rrd"))
    segment.write_bytes(segment.read_bytes()[: int(0.6 * segment.stat().st_size)])
    return directory


def _hostile() -> Iterator[Record]:
    """A drive that no core of ours would do again, with latencies, a gap, and words that are markup."""
    for record in drive(1200):
        if 500 <= record.inputs.cycle < 600:
            continue
        outputs, inputs = record.outputs, record.inputs
        if inputs.cycle % 400 == 7:
            outputs = outputs._replace(events=(Event(Level.ERROR, HOSTILE, HOSTILE * 5),))
        commands = tuple(command._replace(source=HOSTILE) for command in inputs.commands)
        yield Record(inputs._replace(commands=commands), outputs, record.timing)


def _json(command: str, *arguments: object) -> dict[str, Any]:
    result = CliRunner().invoke(build("replay"), ["replay", command, *map(str, arguments)])
    found: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return found | {"exit": result.exit_code}


def _trace(session: Path) -> list[dict[str, str]]:
    """Every channel of every cycle, as `drivegate replay trace` has them."""
    result = CliRunner().invoke(build("replay"), ["replay", "trace", str(session)])
    head, *rows = (line.split(",") for line in result.stdout.splitlines())
    return [dict(zip(head, row, strict=True)) for row in rows]
