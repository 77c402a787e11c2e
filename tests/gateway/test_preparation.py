"""What a robot file needs of each kind of controller, and how its settings are asked for, without any bus."""

import json
import tomllib
from pathlib import Path
from struct import pack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import DRIVERS
from drivers.contract import CanFrame
from drivers.odrive.endpoints import Endpoint, EndpointError, FlatEndpoints, read_flat
from gateway import robot_files
from gateway.config import Motor, RobotConfig, load, parse
from gateway.core.examination import examine
from gateway.setup import prepare_dji, prepare_odrive, prepare_vesc
from gateway.setup.preparation import Ear, Heard, Line, Verdict, rate_line
from gateway.setup.prepare_kinds import KINDS
from gateway.setup.restart import Restart
from gateway.setup.sdo import ATTEMPTS, SETTLE_S, WRITES, Exchange, Job
from tests.setup_robots import kiwi

NODE = 5
MS = 1_000_000
TIMEOUT = Endpoint("axis0.config.watchdog_timeout", 301, "float")
ENABLE = Endpoint("axis0.config.enable_watchdog", 302, "bool")
RATE = Endpoint("axis0.config.can.encoder_msg_rate_ms", 303, "uint32")


def bundled(name: str) -> RobotConfig:
    return load(robot_files.bundled()[name])[0]


def test_every_driver_has_its_row() -> None:
    assert KINDS.keys() == DRIVERS.keys()


# -- asking -----------------------------------------------------------------------------------------------------------


class Controller:
    """Answers by the vendor's description. `loses`: so many of the next frames to it, `confirms`: as from 0.6.11 on."""

    def __init__(self, *, confirms: bool = False, loses: int = 0) -> None:
        self.values = {301: pack("<f", 0.0), 302: b"\0", 303: pack("<I", 10)}
        self.stuck: set[int] = set()
        self.confirms = confirms
        self.loses = loses
        self.asked: list[tuple[int, int, int]] = []  # opcode, endpoint, bytes of the value

    def answers(self, frame: CanFrame) -> list[CanFrame]:
        assert frame.id == NODE << 5 | 4
        opcode, number = frame.data[0], int.from_bytes(frame.data[1:3], "little")
        self.asked.append((opcode, number, len(frame.data) - 4))
        if self.loses:
            self.loses -= 1
            return []
        if opcode == 1 and number not in self.stuck:
            self.values[number] = frame.data[4:]
        told = frame.data[4:] if opcode == 1 else self.values[number]
        return [] if opcode == 1 and not self.confirms else [CanFrame("", NODE << 5 | 5, pack("<xHx", number) + told)]


def exchanged(controller: Controller, *jobs: Job) -> Exchange:
    exchange, now_s = Exchange(NODE, jobs), 0.0
    while not exchange.finished:
        assert now_s < 60.0
        now_s += 0.01
        answers = [answer for frame in exchange.questions(now_s) for answer in controller.answers(frame)]
        for answer in answers:
            exchange.take(answer)
    return exchange


@pytest.mark.parametrize("confirms", [False, True])
def test_a_value_is_written_with_as_many_bytes_as_its_type_and_read_back(*, confirms: bool) -> None:
    controller = Controller(confirms=confirms)
    done = exchanged(controller, Job(TIMEOUT, 0.1), Job(ENABLE, True), Job(RATE))
    assert done.values == {TIMEOUT.path: pytest.approx(0.1), ENABLE.path: True, RATE.path: 10}
    assert controller.asked == [(1, 301, 4), (0, 301, 0), (1, 302, 1), (0, 302, 0), (0, 303, 0)]


@given(loses=st.integers(0, ATTEMPTS - 1), confirms=st.booleans())
def test_lost_frames_are_asked_for_again(loses: int, *, confirms: bool) -> None:
    done = exchanged(Controller(loses=loses, confirms=confirms), Job(RATE, 4))
    assert (done.values, done.silent) == ({RATE.path: 4}, None)


def test_a_confirmation_is_no_read_back() -> None:
    controller = Controller(confirms=True)
    controller.stuck = {302}
    done = exchanged(controller, Job(ENABLE, True))
    assert done.values == {ENABLE.path: False}
    assert [opcode for opcode, _, _ in controller.asked].count(1) == WRITES


def test_after_one_that_does_not_answer_nothing_more_is_written() -> None:
    controller = Controller(loses=10_000)
    done = exchanged(controller, Job(TIMEOUT, 0.1), Job(ENABLE, True))
    assert (done.silent, done.values) == (TIMEOUT, {})
    assert {number for _, number, _ in controller.asked} == {301}


def test_answers_of_others_and_damaged_ones_are_none() -> None:
    exchange = Exchange(NODE, [Job(RATE)])
    exchange.questions(1.0)
    for frame in (
        CanFrame("", 4 << 5 | 5, pack("<xHxI", 303, 4)),
        CanFrame("", NODE << 5 | 5, pack("<xHxI", 302, 4)),
        CanFrame("", NODE << 5 | 5, pack("<xHx", 303)),
        CanFrame("", NODE << 5 | 5, pack("<xHxB", 303, 4)),
        CanFrame("", NODE << 5 | 5, pack("<xHxI", 303, 4), extended=True),
        CanFrame("", NODE << 5 | 5, b"", remote=True),
    ):
        exchange.take(frame)
    assert not exchange.finished
    assert SETTLE_S > 0.0


def test_a_restart_is_one_that_was_seen_to_be_away() -> None:
    def heartbeat(ms: int) -> None:
        restart.take(CanFrame("", NODE << 5 | 1, bytes(8), received_ns=ms * MS))

    restart = Restart(NODE)
    assert restart.questions(0.0) == []  # its absence counts from a heartbeat
    heartbeat(1000)
    assert [(frame.id & 0x1F, frame.data) for frame in restart.questions(0.01)] == [(0x16, b"\1")]
    for ms in range(1100, 3000, 100):
        assert restart.questions(60.0) == []
        heartbeat(ms)
    assert not restart.finished  # it went on as if nothing were, however late we looked
    heartbeat(3600)
    assert not restart.finished
    heartbeat(3950)
    assert restart.finished


def test_a_gap_before_it_was_told_is_no_restart() -> None:
    restart = Restart(NODE)
    for ms in (1000, 1400):
        restart.take(CanFrame("", NODE << 5 | 1, bytes(8), received_ns=ms * MS))
    assert restart.questions(0.5) != []
    for ms in range(1500, 3000, 100):
        restart.take(CanFrame("", NODE << 5 | 1, bytes(8), received_ns=ms * MS))
    assert not restart.finished


def test_one_of_which_no_heartbeat_comes_is_told_all_the_same() -> None:
    assert Restart(NODE).questions(1.0) != []


# -- the vendor's file ------------------------------------------------------------------------------------------------


def flat(**more: object) -> str:
    endpoints = {one.path: {"id": one.number, "type": one.type} for one in (TIMEOUT, ENABLE, RATE)}
    function = {"save_configuration": {"id": 7, "type": "function", "inputs": [], "outputs": []}}
    return json.dumps({"fw_version": "0.6.8-3", "hw_version": "4.4.58", "endpoints": endpoints | function} | more)


def test_the_vendors_file_is_read() -> None:
    found = read_flat(flat())
    assert (found.firmware, found.hardware) == ("0.6.8", "4.4.58")
    assert found.endpoints == {one.path: one for one in (TIMEOUT, ENABLE, RATE)}


@pytest.mark.parametrize(
    "text",
    [
        *("", "{", "null", "1", "[]", "{}", '{"endpoints": []}', flat(fw_version="0.6"), flat(hw_version=None)),
        *(flat(endpoints={"a": 1}), flat(endpoints={"a": {"id": True, "type": "bool"}})),
    ],
)
def test_anything_else_is_refused_in_words(text: str) -> None:
    with pytest.raises(EndpointError, match=r"\w+"):
        read_flat(text)


@given(st.text() | st.recursive(st.none() | st.integers() | st.text(), lambda inner: st.dictionaries(st.text(), inner)))
def test_no_file_breaks_it(given_: object) -> None:
    try:
        read_flat(given_ if isinstance(given_, str) else json.dumps(given_))
    except EndpointError:
        return


def test_a_value_that_a_type_has_not_is_refused() -> None:
    with pytest.raises(EndpointError, match=r"encoder_msg_rate_ms = -1: is no uint32"):
        RATE.raw(-1)


# -- ODrive -----------------------------------------------------------------------------------------------------------


def found_in(lines: list[Line]) -> dict[str, Verdict]:
    return {line.what: line.verdict for line in lines}


def test_what_the_driver_needs_is_in_the_table() -> None:
    config = bundled("moby")
    motor = config.motor[0]
    wanted = {one.path: one.wanted for one in prepare_odrive.settings(config, motor)}
    assert wanted["axis0.config.can.encoder_msg_rate_ms"] == 4
    assert wanted["axis0.config.watchdog_timeout"] == 0.1
    assert wanted["axis0.config.enable_watchdog"] is True
    assert wanted["axis0.controller.config.vel_limit"] == pytest.approx(24.0 * 50.0 / (2.0 * 3.141592653589793))
    assert wanted["axis0.config.motor.current_soft_max"] == 40.0
    assert wanted["axis0.config.startup_closed_loop_control"] is False
    order = list(wanted)
    assert order.index("axis0.config.watchdog_timeout") < order.index("axis0.config.enable_watchdog")
    assert prepare_odrive.bit_rate(config.bus[0]).wanted == 1_000_000


def test_the_endpoints_of_another_firmware_in_the_robot_file_are_told() -> None:
    """188 and 189 of 0.6.10, copied to a robot with 0.6.8, and its version with them."""
    text = kiwi().replace('"0.6.10"', '"0.6.8"')
    motor = parse(text, "kiwi").motor[0]
    assert prepare_odrive.file_line(motor, None).verdict is Verdict.UNKNOWN
    line = prepare_odrive.file_line(motor, read_flat(flat()))
    assert line.verdict is Verdict.NO
    assert (line.wanted, line.found) == (
        "302, 301 of 0.6.8 4.4.58",
        "188, 189 of 0.6.8, hardware unknown",
    )


def test_what_nobody_knows_is_a_warning_of_check() -> None:
    proof = 'watchdog_timeout_endpoint = 189, endpoints_of = "0.6.10 5.2.0" }'
    proven = parse(kiwi().replace("watchdog_timeout_endpoint = 189 }", proof), "kiwi")
    assert prepare_odrive.unproven(proven) == []
    (warned,) = prepare_odrive.unproven(parse(kiwi(), "kiwi"))
    assert warned.startswith("front, rear_left, rear_right: nobody knows for which firmware")
    held = [words for words in examine(bundled("omni4"), "omni4").warnings if "relay in the supply" in words]
    assert held[0].startswith("front_left, rear_left, rear_right, front_right: may hold the last command")
    assert not any("relay in the supply" in words for words in examine(proven, "kiwi").warnings)


def test_the_bundled_numbers_are_those_of_no_controller() -> None:
    for name in robot_files.bundled():
        config = bundled(name)
        assert prepare_odrive.unproven(config) == []
        proofs = [str(motor.options["endpoints_of"]) for motor in config.motor if motor.driver == "odrive"]
        assert all(proof.endswith(" 0.0.0") for proof in proofs)


def test_the_vendors_file_must_have_the_watchdog() -> None:
    with pytest.raises(ValueError, match=r"has no axis0.config.enable_watchdog, axis0.config.watchdog_timeout"):
        prepare_odrive.file_options(FlatEndpoints("0.6.8", "4.4.58", {}))


def test_a_firmware_without_a_parameter_is_told_where_it_is_needed() -> None:
    config = parse(kiwi(), "kiwi")
    wanted = prepare_odrive.settings(config, config.motor[0])
    lines = prepare_odrive.setting_lines(config.motor[0], read_flat(flat()), wanted, {RATE.path: 4}, None)
    verdicts = found_in(lines)
    assert verdicts[RATE.path] is Verdict.OK
    assert verdicts["axis0.controller.config.vel_limit"] is Verdict.UNKNOWN
    assert "axis0.config.startup_homing" not in verdicts


def old_odrive() -> tuple[RobotConfig, Motor]:
    waiver = 'watchdog_waiver = "set over USB, and the e-stop relay cuts the power"'
    lines = [line for line in kiwi().splitlines() if not line.startswith("options")]
    text = "\n".join(waiver if line.startswith("watchdog") else line for line in lines).replace('"0.6"', '"0.5"')
    config = parse(text, "kiwi")
    return config, config.motor[0]


def test_what_to_type_for_firmware_05_are_names_that_it_has() -> None:
    config, motor = old_odrive()
    typed = prepare_odrive.by_hand(motor, config.bus[0])
    assert f"axis.config.can.node_id = {motor.id}" in typed
    assert "odrv0.can.config.baud_rate = 1000000" in typed
    listed = tomllib.loads(
        (Path(__file__).parent.parent / "vectors" / "odrive_05_names.toml").read_text(encoding="utf-8")
    )["names"]
    names = {name.strip() for line in typed for name in line.partition("#")[0].partition("=")[0].split(",")}
    assert {name for name in names if name.startswith(("axis.", "odrv0."))} <= {*listed}
    heard = ear((motor.id << 5 | 1, False, 10.0), (motor.id << 5 | 9, False, 250.0))
    lines = prepare_odrive.heard_lines(heard, motor, config.bus[0])
    assert found_in(lines) == {
        **{"Heartbeat": Verdict.OK, "Get_Encoder_Estimates": Verdict.OK, "error": Verdict.OK},
        "settings": Verdict.UNKNOWN,
    }


# -- VESC and RoboMaster ----------------------------------------------------------------------------------------------


def ear(*messages: tuple[int, bool, float], seconds: float = 2.0) -> Ear:
    """Ids with the rates at which they are heard."""
    found = Ear()
    for at, extended, rate in messages:
        for count in range(round(rate * seconds)):
            found.take(CanFrame("can0", at, bytes(8), extended, received_ns=1 + round(count * 1e9 / rate)))
    return found


def test_a_vesc_by_listening() -> None:
    config = bundled("omni4_vesc")
    motor = config.motor[0]
    rate = motor.feedback_rate or 0.0
    right = prepare_vesc.heard_lines(
        ear(*[(at << 8 | motor.id, True, hz) for at, hz in vesc_rates(rate)]), motor, config.bus[0]
    )
    assert [line.verdict for line in right[:3]] == [Verdict.OK] * 3
    assert right[3].verdict is Verdict.UNKNOWN
    new = prepare_vesc.heard_lines(ear(), motor, config.bus[0])
    assert found_in(new) == {"answers": Verdict.NO}
    half = prepare_vesc.heard_lines(ear((9 << 8 | motor.id, True, 50.0)), motor, config.bus[0])
    assert [line.verdict for line in half[:3]] == [Verdict.NO] * 3
    assert f"rate 1 = {rate:g} Hz" in half[0].todo
    told = " ".join(prepare_vesc.by_hand(motor, config.bus[0]))
    timeout = 0.0 if motor.watchdog is None else motor.watchdog.timeout
    for word in (f"VESC ID = {motor.id};", f"Timeout = {1e3 * timeout:g} ms", "1000K", str(motor.options["min_erpm"])):
        assert word in told


def vesc_rates(rate: float) -> list[tuple[int, float]]:
    return [(9, rate), (27, rate), (16, 10.0)]


def test_robomaster_controllers_by_listening() -> None:
    config = bundled("omni4_gm6020")
    motor = config.motor[0]
    lines = prepare_dji.heard_lines(ear((0x204 + motor.id, False, 1000.0)), motor, config.bus[0])
    assert found_in(lines) == {
        "reports": Verdict.OK,
        "mode": Verdict.UNKNOWN,
        "silence of the host": Verdict.UNKNOWN,
    }
    silent = prepare_dji.heard_lines(ear(), motor, config.bus[0])
    assert "its switches 1 to 3" in silent[0].todo
    slow = prepare_dji.heard_lines(ear(), motor, config.bus[0].model_copy(update={"bitrate": 500_000}))
    assert found_in(slow)["bit rate"] is Verdict.NO


@pytest.mark.parametrize(
    ("heard", "at_least", "verdict"),
    [
        (None, False, Verdict.NO),
        (Heard(2, None, b""), False, Verdict.NO),
        (Heard(9, 49.0, b""), False, Verdict.NO),
        (Heard(9, 75.0, b""), False, Verdict.UNKNOWN),
        (Heard(9, 99.0, b""), False, Verdict.OK),
        (Heard(9, 160.0, b""), False, Verdict.NO),
        (Heard(9, 160.0, b""), True, Verdict.OK),
    ],
)
def test_a_rate(heard: Heard | None, at_least: bool, verdict: Verdict) -> None:
    line = rate_line("left", "STATUS", 100.0, heard, "do", at_least=at_least)
    assert line.verdict is verdict
    assert (line.todo == "") == (verdict is Verdict.OK)


def test_an_ear_tells_rates_by_stamps() -> None:
    found = ear((0x123, False, 250.0)).of(0x123)
    assert found is not None
    assert found.rate_hz == pytest.approx(250.0)
    assert ear((0x123, False, 250.0)).of(0x123, extended=True) is None
