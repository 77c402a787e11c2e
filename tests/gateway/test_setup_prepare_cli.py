"""`drivegate setup prepare` on simulated controllers in real time: found wrong, set, read back, saved, and found right."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import Result

from gateway.config import load
from replay.sim.controllers.odrive import SimulatedODrive
from tests.gateway.test_setup_cli import Stand, called, document

ENCODER_MS = "axis0.config.can.encoder_msg_rate_ms"
BAUD_RATE = "can.config.baud_rate"
ENABLE, TIMEOUT = "axis0.config.enable_watchdog", "axis0.config.watchdog_timeout"
FROM_THE_FACTORY = {ENCODER_MS: 10.0, ENABLE: 0.0, TIMEOUT: 0.0, "axis0.config.startup_closed_loop_control": 1.0}


@pytest.fixture
def stand(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Callable[..., Stand]]:
    made: list[Stand] = []

    def make(name: str, wrong: Callable[[str], str] = str) -> Stand:
        made.append(Stand(tmp_path, request.node.name, name, wrong))
        return made[-1]

    yield make
    for one in made:
        one.close()


def odrives(one: Stand) -> dict[str, SimulatedODrive]:
    return {name: device for name, device in one.server.robot.devices.items() if isinstance(device, SimulatedODrive)}


def flat_file(one: Stand, **changes: object) -> Path:
    """The vendor's file of the controllers on the stand, with some of its keys changed."""
    path = one.file.parent / "flat_endpoints.json"
    path.write_text(json.dumps(next(iter(odrives(one).values())).flat_endpoints() | changes))
    return path


def set_wrong(device: SimulatedODrive, values: dict[str, float]) -> None:
    device.axis.parameters.put(values)
    device.axis.parameters.save()


def prepared(one: Stand, *arguments: object) -> Result:
    return called("prepare", one.file, *arguments, "--seconds", "1", "--json")


def rows(result: Result) -> dict[tuple[str, str], tuple[str, str, str]]:
    """Wanted, found and verdict by motor and what."""
    lines = document(result)["lines"]
    assert isinstance(lines, list)
    return {(row["motor"], row["what"]): (row["wanted"], row["found"], row["verdict"]) for row in lines}


def test_what_is_wrong_is_told_then_set_and_saved(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    set_wrong(device, FROM_THE_FACTORY)
    flat = flat_file(one)

    told = prepared(one, "front", "--endpoints", flat)
    assert told.exit_code == 1
    assert rows(told)["front", ENCODER_MS] == ("4", "10", "no")
    assert rows(told)["front", ENABLE] == ("true", "false", "no")
    assert "a person has to let it happen" in told.stderr
    assert device.axis.parameters[ENABLE] == 0.0

    done = prepared(one, "front", "--endpoints", flat, "--yes")
    assert done.exit_code == 0, done.output
    assert f"front: {ENCODER_MS} = 4" in document(done)["changed"]  # type: ignore[operator]
    assert {verdict for _, _, verdict in rows(done).values()} == {"ok"}
    device.power_cycle()
    assert {name: device.axis.parameters[name] for name in FROM_THE_FACTORY} == {
        ENCODER_MS: 4.0,
        ENABLE: 1.0,
        TIMEOUT: pytest.approx(0.1),
        "axis0.config.startup_closed_loop_control": 0.0,
    }
    assert load(one.file)[0].motor[0].options["endpoints_of"] == "0.6.10 5.2.0"
    assert not one.moved

    again = prepared(one, "front", "--endpoints", flat)
    assert (again.exit_code, document(again)["changed"]) == (0, []), again.output
