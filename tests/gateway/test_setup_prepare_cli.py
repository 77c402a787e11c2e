"""`drivegate setup prepare` on simulated controllers in real time: found wrong, set, read back, saved, found right."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import Result

from gateway.config import load
from gateway.edges.claims import Claims
from gateway.edges.turning import turn
from gateway.setup.calibrating import Calibration, Outcome
from replay.sim.controllers.odrive import SimulatedODrive
from replay.sim.controllers.odrive_parameters import CALIBRATED
from replay.sim.controllers.vesc import SimulatedVesc
from tests.setup_robots import TRUE
from tests.setup_stand import Stand, called, document, stands
from tests.world import robot_text

ENCODER_MS = "axis0.config.can.encoder_msg_rate_ms"
BAUD_RATE = "can.config.baud_rate"
ENABLE, TIMEOUT = "axis0.config.enable_watchdog", "axis0.config.watchdog_timeout"
FROM_THE_FACTORY = {ENCODER_MS: 10.0, ENABLE: 0.0, TIMEOUT: 0.0, "axis0.config.startup_closed_loop_control": 1.0}


@pytest.fixture
def stand(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Callable[..., Stand]]:
    with stands(tmp_path, request.node.name) as make:
        yield make


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


def reason(result: Result) -> str:
    found = document(result)
    assert not found["ok"]
    return str(found["reason"])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fw_version": "0.6.8"}, "0.6.8, hardware 5.2.0"),
        ({"hw_version": "4.4.58"}, "0.6.10, hardware 4.4.58"),
    ],
    ids=["firmware", "hardware"],
)
def test_the_vendors_file_of_another_one_is_not_used(
    stand: Callable[..., Stand], changes: dict[str, str], words: str
) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    set_wrong(device, FROM_THE_FACTORY)
    before = one.file.read_text()
    result = prepared(one, "front", "--endpoints", flat_file(one, **changes), "--yes")
    assert result.exit_code == 1
    wanted, found, verdict = rows(result)["front", "firmware"]
    assert (words in wanted, found, verdict) == (True, "0.6.10, hardware 5.2.0", "no")
    assert ("front", ENABLE) not in rows(result)
    assert device.axis.parameters[ENABLE] == 0.0
    assert one.file.read_text() == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is no JSON"),
        ("[]", "has no endpoints"),
        ('{"endpoints": {}, "hw_version": "5.2.0"}', "fw_version = None: must be three numbers"),
        ('{"endpoints": {"a": {"id": 70000, "type": "bool"}}, "fw_version": "0.6.10", "hw_version": "5.2.0"}', "70000"),
    ],
    ids=["empty", "list", "no version", "number"],
)
def test_what_is_not_the_vendors_file_is_refused(
    stand: Callable[..., Stand], tmp_path: Path, text: str, words: str
) -> None:
    flat = tmp_path / "flat.json"
    flat.write_text(text)
    result = prepared(stand("kiwi"), "front", "--endpoints", flat)
    assert result.exit_code == 1
    assert str(flat) in reason(result)
    assert words in reason(result)


@pytest.mark.parametrize(
    ("path", "entry", "words"),
    [(TIMEOUT, None, f"has no {TIMEOUT}"), (TIMEOUT, {"id": 189, "type": "uint8"}, "is no uint8")],
    ids=["missing", "type"],
)
def test_endpoints_that_cannot_be(stand: Callable[..., Stand], path: str, entry: object, words: str) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    set_wrong(device, FROM_THE_FACTORY)
    every = device.flat_endpoints()["endpoints"]
    assert isinstance(every, dict)
    endpoints = {name: found for name, found in (every | {path: entry}).items() if found is not None}
    before = one.file.read_text()
    result = prepared(one, "front", "--endpoints", flat_file(one, endpoints=endpoints), "--yes")
    assert (result.exit_code, words in reason(result)) == (1, True)
    assert one.file.read_text() == before
    device.power_cycle()
    assert device.axis.parameters[ENABLE] == 0.0


def test_one_that_does_not_answer_is_told_and_not_written(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    device.answers_sdo = False
    result = prepared(one, "front", "--endpoints", flat_file(one), "--yes")
    assert result.exit_code == 1
    assert rows(result)["front", "axis0.config.can.node_id"] == ("an answer", "does not answer RxSdo", "no")
    assert document(result)["changed"] == []


def test_what_reads_back_otherwise_is_not_saved(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    set_wrong(device, FROM_THE_FACTORY)
    device.axis.parameters.stuck = {ENABLE}
    result = prepared(one, "front", "--endpoints", flat_file(one), "--yes")
    assert result.exit_code == 1
    assert f"front: {ENABLE} = true reads back false: nothing is saved" in reason(result)
    device.power_cycle()
    assert device.axis.parameters[ENCODER_MS] == 10.0


def test_one_that_is_armed_is_left_alone(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    set_wrong(device, FROM_THE_FACTORY)
    device.axis.request(8)
    result = prepared(one, "front", "--endpoints", flat_file(one), "--yes")
    assert result.exit_code == 1
    assert "front: not idle" in reason(result)
    assert device.axis.parameters[ENABLE] == 0.0


def test_one_that_is_armed_before_the_yes_is_left_alone(
    stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    set_wrong(device, FROM_THE_FACTORY)
    monkeypatch.setattr("gateway.cli.preparing.allow", lambda *_, **__: device.axis.request(8))
    result = prepared(one, "front", "--endpoints", flat_file(one))
    assert (result.exit_code, "front: not idle any more" in reason(result)) == (1, True)
    assert device.axis.parameters[ENABLE] == 0.0


def test_a_gateway_on_the_bus_is_left_alone(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    claims = Claims("virtual", one.channel, [0x7FF])
    result = prepared(one, "--endpoints", flat_file(one), "--yes")
    claims.release()
    assert type(result.exception).__name__ == "InUseError"


def test_another_bit_rate_comes_last_and_to_all_of_a_bus(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    for device in odrives(one).values():
        set_wrong(device, {BAUD_RATE: 250_000.0, ENCODER_MS: 10.0})
        device.setup = device.setup._replace(bitrate=250_000)  # of the link, as it is now
        device.power_cycle()
    flat = flat_file(one)
    alone = prepared(one, "front", "--endpoints", flat, "--yes")
    assert (alone.exit_code, "another bit rate goes to all of its motors at once" in reason(alone)) == (1, True)
    assert odrives(one)["front"].axis.parameters[BAUD_RATE] == 250_000.0
    result = prepared(one, "--endpoints", flat, "--yes")
    assert "restart with 1000000 bit/s: `ip link set" in result.stderr
    assert rows(result)["front", BAUD_RATE][2] == "unknown"
    for device in odrives(one).values():
        device.setup = device.setup._replace(bitrate=1_000_000)  # somebody set the link
    again = prepared(one, "--endpoints", flat)
    assert (again.exit_code, document(again)["changed"]) == (0, []), again.output


def test_a_waived_watchdog_is_given(stand: Callable[..., Stand]) -> None:
    def waived(text: str) -> str:
        lines = [line for line in text.splitlines() if not line.startswith("options")]
        waiver = 'watchdog_waiver = "not set up yet: endpoints of this firmware are to be looked up"'
        return "\n".join(waiver if line.startswith("watchdog") else line for line in lines) + "\n"

    one = stand("kiwi", waived)
    arguments = ["--endpoints", flat_file(one), "--yes"]
    assert rows(prepared(one, *arguments))["front", "endpoints in the robot file"][2] == "unknown"
    first = prepared(one, *arguments, "--watchdog", "0.1")
    assert document(first)["kept"] is not None
    assert "run it once more to set it" in first.stderr
    motor = load(one.file)[0].motor[0]
    assert (motor.watchdog is not None, motor.watchdog_waiver) == (True, None)
    assert motor.options["watchdog_enable_endpoint"] == 188
    second = prepared(one, *arguments)
    assert second.exit_code == 0, second.output
    assert odrives(one)["front"].axis.parameters[ENABLE] == 1.0


def test_robomaster_controllers_are_listened_to(stand: Callable[..., Stand]) -> None:
    one = stand("rectangular")
    result = prepared(one)
    assert result.exit_code == 0, result.output
    found = rows(result)
    assert found["rear_right", "silence of the host"][1:] == ("no command timeout", "unknown")
    one.server.robot.devices["rear_right"].power_off()
    gone = prepared(one, "rear_right")
    assert (gone.exit_code, rows(gone)["rear_right", "answers"][1:]) == (1, ("silent", "no"))
    assert "relay" in gone.output


def test_vescs_are_listened_to_and_told_what_to_set(
    stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(TRUE, "omni4_vesc", lambda: robot_text("omni4_vesc"))
    one = stand("omni4_vesc")
    right = prepared(one)
    assert right.exit_code == 0, right.output
    first = one.config.motors_in_order()[0]
    assert rows(right)[first.name, "STATUS_5"][2] == "ok"
    assert rows(right)[first.name, "command timeout"][1:] == ("not told", "unknown")
    by_hand = document(right)["by_hand"]
    assert isinstance(by_hand, dict)
    assert f"VESC ID = {first.id};" in by_hand[first.name][0]
    device = one.server.robot.devices[first.name]
    assert isinstance(device, SimulatedVesc)
    monkeypatch.setattr(device, "_clocks", (((9,), device._clocks[0][1]),))  # somebody ticked STATUS 1 alone
    wrong = prepared(one, first.name)
    assert (wrong.exit_code, rows(wrong)[first.name, "STATUS_5"][1:]) == (1, ("never heard", "no"))


def test_ctrl_c_says_what_is_left(stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    one = stand("kiwi")
    monkeypatch.setattr("gateway.cli.preparing.listen", interrupted)
    result = prepared(one, "front")
    assert (result.exit_code, "not yet saved is gone" in reason(result)) == (1, True)


def test_a_motor_that_is_not_in_the_file(stand: Callable[..., Stand]) -> None:
    result = prepared(stand("kiwi"), "nose")
    assert result.exit_code == 1
    assert "there is front, rear_left, rear_right" in reason(result)


def test_a_calibration_needs_a_word_of_its_own(stand: Callable[..., Stand]) -> None:
    one = stand("kiwi")
    device = odrives(one)["front"]
    set_wrong(device, dict.fromkeys(CALIBRATED, 0.0))
    flat = flat_file(one)
    result = prepared(one, "front", "--endpoints", flat, "--yes")
    assert result.exit_code == 1
    assert rows(result)["front", CALIBRATED[0]] == ("true", "false", "no")
    assert set(one.plant.angles) == {0.0}
    turned = prepared(one, "front", "--endpoints", flat, "--yes", "--calibrate")
    assert turned.exit_code == 0, turned.output
    assert "Lift the robot" in turned.stderr
    assert one.plant.angles[0] != 0.0
    assert one.plant.angles[1:] == (0.0, 0.0)
    device.power_cycle()
    assert all(device.axis.parameters[name] for name in CALIBRATED)


def test_ctrl_c_late_in_a_calibration_is_heeded(stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not saved, and no other motor turns."""

    def turned(*arguments: object, period_ns: int) -> None:
        turn(*arguments, period_ns=period_ns)  # type: ignore[arg-type]
        arguments[2].ask("signal 2")  # type: ignore[attr-defined]

    monkeypatch.setattr("gateway.cli.preparing.turn", turned)
    one = stand("kiwi")
    for device in odrives(one).values():
        set_wrong(device, dict.fromkeys(CALIBRATED, 0.0))
    result = prepared(one, "--endpoints", flat_file(one), "--yes", "--calibrate")
    assert (result.exit_code, "signal 2" in reason(result)) == (1, True)
    assert sum(angle != 0.0 for angle in one.plant.angles) == 1
    device = odrives(one)["front"]
    device.power_cycle()
    assert not device.axis.parameters[CALIBRATED[0]]


def test_one_that_is_not_released_is_not_saved(stand: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch) -> None:
    """Saving would restart it, whatever drives it; and no other motor turns."""

    def turned(_: object, procedure: Calibration, *rest: object, period_ns: int) -> None:
        turn(_, procedure, *rest, period_ns=period_ns)  # type: ignore[arg-type]
        assert procedure.outcome == Outcome(ok=True, reason="", released=True)
        procedure.outcome = procedure.outcome._replace(released=False)

    monkeypatch.setattr("gateway.cli.preparing.turn", turned)
    one = stand("kiwi")
    for device in odrives(one).values():
        set_wrong(device, dict.fromkeys(CALIBRATED, 0.0))
    result = prepared(one, "--endpoints", flat_file(one), "--yes", "--calibrate")
    assert result.exit_code == 1
    assert "front: calibrated, but not saved; it did not confirm that it is released: cut its power" in reason(result)
    assert one.plant.angles[1:] == (0.0, 0.0)
    device = odrives(one)["front"]
    device.power_cycle()
    assert not device.axis.parameters[CALIBRATED[0]]
