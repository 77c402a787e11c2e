"""`drivegate setup prepare` in virtual time: whatever happens meanwhile, nothing is set or turned that must not be."""

import json
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import partial
from io import StringIO
from pathlib import Path
from unittest.mock import patch

import pytest
import typer

from drivers.contract import CanFrame
from gateway.cli import preparing
from gateway.cli.app import build
from gateway.config import RobotConfig, parse
from gateway.edges.claims import Claims, InUseError
from gateway.edges.listening import Place
from gateway.edges.turning import turn
from gateway.setup.calibrating import FULL_CALIBRATION, Calibration
from replay.sim.controllers.odrive import BOOT_NS, SimulatedODrive
from replay.sim.controllers.odrive_parameters import BAUD_RATE, CALIBRATED, ENABLE_WATCHDOG, ENCODER_MS
from replay.sim.controllers.odrive_tables import Command
from tests.gateway.test_setup_inputs import Buses, Terminal
from tests.jogging import MS, Bench
from tests.setup_robots import kiwi

CHANNEL = f"can{os.getpid()}"  # claims are of the whole computer
READ = 0  # of RxSdo
NOBODY: Callable[..., object] = lambda _gone: ()  # noqa: E731  # a default is one line
Disturb = Callable[[], None]


class Prepared:
    """A kiwi on a stand, and the file that a person has of it. `disturb`: called in every cycle of the bus."""

    def __init__(self, directory: Path, text: str = kiwi()) -> None:
        self.bench = Bench(parse(text, "true"))
        self.file = directory / "kiwi.toml"
        self.file.write_text(text.replace('channel = "can', f'channel = "{CHANNEL}_'))
        self.flat = directory / "flat_endpoints.json"
        self.flat.write_text(json.dumps(self["front"].flat_endpoints()))
        self.disturb: Disturb = lambda: None
        self.said = ""

    def __getitem__(self, name: str) -> SimulatedODrive:
        device = self.bench.bus.robot.devices[name]
        assert isinstance(device, SimulatedODrive)
        return device

    @property
    def devices(self) -> dict[str, SimulatedODrive]:
        return {name: self[name] for name in self.bench.bus.robot.devices}

    @property
    def moved(self) -> bool:
        return any(angle != 0.0 for angle in self.bench.plant.angles)

    def put(self, values: dict[str, float], *names: str) -> None:
        """Saved in these, or in all."""
        for name in names or self.devices:
            self[name].axis.parameters.put(values)
            self[name].axis.parameters.save()

    def __call__(
        self, *options: str, typed: Sequence[str] = (), terminal: bool = False
    ) -> tuple[int, dict[str, object]]:
        """Its exit code, and what it tells a program."""
        out, err, code = StringIO(), StringIO(), 1
        arguments = ["setup", "prepare", str(self.file), *options, "--endpoints", str(self.flat), "--json"]
        with (
            patch.object(preparing, "listen", self._listen),
            patch.object(preparing, "CanBuses", self._opened),
            patch.object(preparing, "turn", self._turn),
            patch.object(sys, "stdin", Terminal(typed, terminal=terminal)),
            redirect_stdout(out),
            redirect_stderr(err),
            suppress(typer.Exit),
        ):
            code = build("setup")([*arguments, "--seconds", "1"], standalone_mode=False) or 0
        self.said = err.getvalue()
        return code, json.loads(out.getvalue())

    def _listen(
        self, place: Place, seconds: float, take: Callable[[CanFrame], None], **more: Callable[..., object]
    ) -> dict[str, int]:
        bus, begin_ns = f"can{place.channel.rpartition('_')[2]}", self.bench.now_ns
        while (gone := (self.bench.now_ns - begin_ns) * 1e-9) < seconds and more.get("going_on", lambda: True)():
            self.bench.send([frame._replace(bus=bus) for frame in more.get("questions", NOBODY)(gone)])  # type: ignore[attr-defined]
            self.disturb()
            for frame in self.bench.cycle():
                if frame.bus == bus:
                    take(frame)
        return {}

    def _opened(self, _config: RobotConfig) -> Buses:
        return Buses(self.bench, lambda _: self.disturb())

    def _turn(self, buses: Buses, procedure: Calibration, *rest: object, period_ns: int) -> None:
        def sleep(seconds: float) -> None:
            self.bench.now_ns += max(1, round(seconds * 1e9))

        loop = partial(turn, clock=lambda: self.bench.now_ns, sleep=sleep, period_ns=period_ns)
        loop(buses, procedure, *rest)  # type: ignore[arg-type]


def sdos(one: Prepared) -> list[CanFrame]:
    return [frame for _, frame in one.bench.sent if frame.id & 0x1F == Command.RX_SDO_06]


# -- whose bus it is --------------------------------------------------------------------------------------------------


def test_no_gateway_begins_meanwhile(tmp_path: Path) -> None:
    """It would drive what is then started anew."""
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0})
    found: set[bool] = set()
    identifiers = [device.node << 5 | 0x07 for device in one.devices.values()]

    def begin() -> None:
        for identifier in identifiers:
            try:
                Claims("socketcan", f"{CHANNEL}_0", [identifier]).release()
                found.add(True)
            except InUseError:
                found.add(False)

    one.disturb = begin
    code, told = one("--yes")
    assert (code, told["ok"]) == (0, True)
    assert found == {False}
    Claims("socketcan", f"{CHANNEL}_0", identifiers).release()


BUS = """[[bus]]
name = "can1"
interface = "socketcan"
channel = "can1"
bitrate = 1_000_000

[commands]"""


def on_two_buses() -> str:
    """Rear left is alone on the second one."""
    text = kiwi().replace("[commands]", BUS)
    return text.replace('name = "rear_left"\nbus = "can0"', 'name = "rear_left"\nbus = "can1"')


def test_a_gateway_on_another_bus_is_not_in_the_way(tmp_path: Path) -> None:
    one = Prepared(tmp_path, on_two_buses())
    claims = Claims("socketcan", f"{CHANNEL}_1", [0x7FF])
    assert one("front", "--yes")[0] == 0
    with pytest.raises(InUseError):
        one("rear_left", "--yes")
    claims.release()


def test_a_gateway_that_began_before_a_calibration_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever it commands there."""
    one = Prepared(tmp_path)
    one("--yes")
    one.put(dict.fromkeys(CALIBRATED, 0.0))
    claims: list[Claims] = []
    begin = lambda *_, **__: claims.append(Claims("socketcan", f"{CHANNEL}_0", [0x7FF]))  # noqa: E731
    monkeypatch.setattr("gateway.cli.preparing.allow", begin)
    with pytest.raises(InUseError):
        one("--calibrate")
    claims[0].release()
    assert not one.moved


def test_where_two_share_an_id_nothing_is_asked(tmp_path: Path) -> None:
    """Both would take what is written."""
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0}, "front")
    one.bench.bus.add_twin("front", 1.0)
    code, told = one("--yes")
    assert (code, "nothing was asked and nothing is set" in str(told["reason"])) == (1, True)
    assert "can0: " in str(told["reason"])
    assert sdos(one) == []


def test_one_that_is_armed_before_the_yes_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0})
    monkeypatch.setattr("gateway.cli.preparing.allow", lambda *_, **__: one["front"].axis.request(8))
    code, told = one()
    assert (code, told["reason"]) == (1, "front: not idle any more: nothing more is set")
    assert {frame.data[0] for frame in sdos(one)} == {READ}
    assert one["front"].axis.state == 8


# -- what is set ------------------------------------------------------------------------------------------------------


def test_of_one_that_falls_silent_half_way_nothing_is_set(tmp_path: Path) -> None:
    """Who else talks to it, that it does not hear us?"""
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0}, "front")

    def silent() -> None:
        one["front"].answers_sdo = len(sdos(one)) < 5

    one.disturb = silent
    code, told = one("front", "--yes")
    assert (code, told["changed"]) == (1, [])
    found = {(line["what"], line["found"]) for line in told["lines"]}  # type: ignore[attr-defined]
    assert (ENCODER_MS, "10") in found  # it was read
    assert "does not answer RxSdo" in {words for _, words in found}
    assert {frame.data[0] for frame in sdos(one)} == {READ}
    assert one["front"].axis.parameters[ENCODER_MS] == 10.0


def test_where_one_is_armed_none_is_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0})
    one["rear_left"].axis.request(8)
    asked: list[object] = []
    monkeypatch.setattr("gateway.cli.preparing.allow", lambda *_, **__: asked.append(1))
    code, told = one()
    assert (code, told["reason"]) == (1, "rear_left: not idle, or nobody hears it: nothing is set")
    assert asked == []
    assert {device.axis.parameters[ENCODER_MS] for device in one.devices.values()} == {10.0}
    assert one["rear_left"].axis.state == 8


def test_what_reads_back_otherwise_is_not_saved(tmp_path: Path) -> None:
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0}, "front")
    one["front"].axis.parameters.stuck = {ENABLE_WATCHDOG}
    code, told = one("front", "--yes")
    assert (code, "= true reads back false: nothing is saved" in str(told["reason"])) == (1, True)
    one["front"].power_cycle()
    assert one["front"].axis.parameters[ENCODER_MS] == 10.0


def test_nor_is_what_nobody_reads_back(tmp_path: Path) -> None:
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0}, "front")

    def silent() -> None:
        one["front"].answers_sdo = all(frame.data[0] == READ for frame in sdos(one))

    one.disturb = silent
    code, told = one("front", "--yes")
    assert (code, "= 4 is not answered: nothing is saved" in str(told["reason"])) == (1, True)
    assert [frame for _, frame in one.bench.sent if frame.id & 0x1F == Command.REBOOT] == []


# -- another bit rate -------------------------------------------------------------------------------------------------

OLD, NEW = 250_000, 1_000_000


def link(one: Prepared, rate: int, *names: str) -> None:
    """Somebody gives the links of these this bit rate, or all."""
    for name in names or one.devices:
        one[name].setup = one[name].setup._replace(bitrate=rate)


def slow(directory: Path, text: str = kiwi(), *names: str) -> Prepared:
    """A robot on which these, or all, have the bit rate from the factory, and so have their links."""
    one = Prepared(directory, text)
    link(one, OLD, *names)
    one.put({BAUD_RATE: OLD, ENCODER_MS: 10.0}, *names)
    for name in names or one.devices:
        one[name].power_cycle()
    return one


def verdicts(told: dict[str, object]) -> dict[tuple[str, str], str]:
    return {(line["motor"], line["what"]): line["verdict"] for line in told["lines"]}  # type: ignore[attr-defined]


def test_what_cannot_be_looked_at_before_the_link_is_set_is_unknown(tmp_path: Path) -> None:
    one = slow(tmp_path)
    one.put({ENCODER_MS: 4.0}, "rear_left")
    one["rear_left"].power_cycle()
    code, told = one("--yes")
    assert (code, told["ok"]) == (0, True)
    assert f"can0: its controllers restart with {NEW} bit/s: `ip link set {CHANNEL}_0 down; " in one.said
    found = verdicts(told)
    for name in one.devices:
        assert {found[name, what] for what in (BAUD_RATE, ENABLE_WATCHDOG)} == {"unknown"}
    assert {found["front", what] for what in (ENCODER_MS, "Get_Encoder_Estimates")} == {"unknown"}
    assert found["rear_left", ENCODER_MS] == "ok"
    link(one, NEW)
    code, told = one()
    assert (code, told["changed"], set(verdicts(told).values())) == (0, [], {"ok"})


def test_all_restart_before_one_of_them_is_back(tmp_path: Path) -> None:
    """With its new bit rate it disturbs those that have the old one."""
    one = slow(tmp_path)
    one("--yes")
    back = [device._booted_ns for device in one.devices.values()]
    assert min(back) > one.bench.now_ns - 10**9
    assert max(back) - min(back) < BOOT_NS / 2


def test_none_calibrates_before_the_link_is_set(tmp_path: Path) -> None:
    one = slow(tmp_path)
    one.put(dict.fromkeys(CALIBRATED, 0.0), "front", "rear_left")
    code, told = one("--yes", "--calibrate")
    words = f"front, rear_left: not calibrated: can0: its controllers restart with {NEW} bit/s: "
    link_words = f"`ip link set {CHANNEL}_0 down; ip link set {CHANNEL}_0 up type can bitrate {NEW} restart-ms 100`"
    assert (code, f"{words}{link_words}, then" in str(told["reason"])) == (1, True)
    assert "Lift the robot" not in one.said
    link(one, NEW)
    assert not one.moved
    assert one("--yes", "--calibrate")[0] == 0
    assert one.moved


def test_the_other_bus_is_looked_at_anew(tmp_path: Path) -> None:
    """And nothing of it calibrates meanwhile."""
    text = on_two_buses()
    one = slow(tmp_path, text, "front", "rear_right")
    one.put({ENCODER_MS: 10.0} | dict.fromkeys(CALIBRATED, 0.0), "rear_left")
    one.put(dict.fromkeys(CALIBRATED, 0.0), "front")
    code, told = one("--yes")
    found = verdicts(told)
    assert [found[name, ENCODER_MS] for name in ("front", "rear_left", "rear_right")] == ["unknown", "ok", "unknown"]
    assert list(dict.fromkeys(motor for motor, _ in found)) == ["front", "rear_left", "rear_right"]
    assert code == 1  # not calibrated
    link(one, OLD, "front", "rear_right")
    one = slow(tmp_path, text, "front", "rear_right")
    one.put(dict.fromkeys(CALIBRATED, 0.0), "front", "rear_left")
    code, told = one("--yes", "--calibrate")
    assert (code, str(told["reason"]).startswith("front: not calibrated: can0")) == (1, True)
    assert not one.moved


def test_one_that_has_it_already_restarts_with_the_others(tmp_path: Path) -> None:
    """It would stay where it is until somebody switches it off."""
    one = slow(tmp_path)
    one["front"].axis.parameters.put({BAUD_RATE: NEW})
    assert one("--yes")[0] == 0
    link(one, NEW)
    one.bench.wait(1.0)
    assert all(device.acknowledges for device in one.devices.values())


@pytest.mark.parametrize("mute", ["powered", "answers_sdo"])
def test_where_one_would_keep_the_old_one_none_gets_another(tmp_path: Path, mute: str) -> None:
    """The bus would be dead for all, once it is switched on."""
    one = slow(tmp_path)
    setattr(one["rear_left"], mute, False)
    code, told = one("--yes")
    words = "can0: another bit rate goes to all of its motors at once, and rear_left would keep this one: "
    assert (code, str(told["reason"]).startswith(words)) == (1, True)
    assert {frame.data[0] for frame in sdos(one)} == {READ}


@pytest.mark.parametrize("powered", [True, False])
def test_one_that_is_not_set_over_can_is_first(tmp_path: Path, powered: bool) -> None:
    """By hand; from then on it is not heard."""
    before, last = kiwi().rsplit("[[motor]]", 1)
    last = last.replace('"0.6"', '"0.5"').replace(
        "watchdog = { timeout = 0.1 }", 'watchdog_waiver = "its timeout was set over USB"'
    )
    text = "".join(f"{line}\n" for line in f"{before}[[motor]]{last}".splitlines())
    text = text[: text.rindex("options = ")]
    one = Prepared(tmp_path, text)
    link(one, OLD)
    one.put({BAUD_RATE: OLD}, "front", "rear_left")
    one["front"].power_cycle()
    one["rear_left"].power_cycle()
    one["rear_right"].powered = powered
    one["rear_right"]._baud_rate = OLD
    _, told = one("--yes")
    assert ("rear_right would keep this one" in str(told.get("reason"))) is powered
    assert ("restart with" in one.said) is not powered


def arm(device: SimulatedODrive, now_ns: int) -> None:
    """By somebody who feeds its watchdog."""
    device.axis.request(8)
    device.axis.feed_watchdog(now_ns)


def test_where_one_is_armed_before_they_restart_none_does(tmp_path: Path) -> None:
    one = slow(tmp_path)

    def late() -> None:
        if all(device.axis.parameters[BAUD_RATE] == NEW for device in one.devices.values()):
            arm(one["rear_right"], one.bench.now_ns)

    one.disturb = late
    code, told = one("--yes")
    assert (code, told["reason"]) == (1, "rear_right: not idle any more: nothing more is set")
    assert one["rear_right"].axis.state == 8
    for device in one.devices.values():
        device.power_cycle()
        assert device.axis.parameters[BAUD_RATE] == OLD


def test_where_one_that_has_it_already_is_armed_none_gets_another(tmp_path: Path) -> None:
    """It would be let go."""
    one = Prepared(tmp_path)
    one("--yes")
    link(one, OLD)
    one.put({BAUD_RATE: OLD}, "rear_left", "rear_right")
    for device in one.devices.values():
        device._baud_rate = OLD
    one.disturb = lambda: arm(one["front"], one.bench.now_ns)
    code, told = one("--yes")
    assert (code, told["reason"]) == (1, "front: not idle, or nobody hears it: nothing is set")
    assert one["rear_left"].axis.parameters[BAUD_RATE] == OLD


# -- what turns -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("typed", "terminal"), [(("no",), True), (("",), True), (("y",), True), ((), True), (("yes",), False)]
)
def test_without_a_yes_none_calibrates(tmp_path: Path, typed: tuple[str, ...], terminal: bool) -> None:
    one = Prepared(tmp_path)
    one("--yes")
    one.put(dict.fromkeys(CALIBRATED, 0.0))
    before = one.file.read_text()
    code, _ = one("--calibrate", typed=typed, terminal=terminal)
    assert (code, "Lift the robot" in one.said) == (1, True)
    assert [frame for _, frame in one.bench.sent if frame.id & 0x1F == Command.SET_AXIS_STATE] == []
    assert not one.moved
    assert one.file.read_text() == before


def test_a_yes_to_what_is_set_is_none_to_turning(tmp_path: Path) -> None:
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0} | dict.fromkeys(CALIBRATED, 0.0))
    code, _ = one("--calibrate", typed=("yes", "yes", "no"), terminal=True)
    assert one["front"].axis.parameters[ENCODER_MS] == 4.0
    assert (code, one.moved, "nobody let it happen" in one.said) == (1, False, True)
    assert one("--calibrate", typed=("yes",), terminal=True)[0] == 0
    assert one.moved


def test_a_gateway_that_began_while_it_turned_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Saving would restart what it drives by now."""
    one = Prepared(tmp_path)
    one("--yes")
    one.put(dict.fromkeys(CALIBRATED, 0.0), "front")
    claims: list[Claims] = []
    begin = lambda _: claims.append(Claims("socketcan", f"{CHANNEL}_0", [0x7FF]))  # noqa: E731
    monkeypatch.setattr(Buses, "close", begin)
    with pytest.raises(InUseError):
        one("front", "--yes", "--calibrate")
    claims[0].release()
    assert one["front"].axis.parameters[CALIBRATED[0]] == 1.0
    one["front"].power_cycle()
    assert one["front"].axis.parameters[CALIBRATED[0]] == 0.0


def test_one_that_does_not_come_back_is_told(tmp_path: Path) -> None:
    one = Prepared(tmp_path)
    one.put({ENCODER_MS: 10.0}, "front")
    one["front"]._handlers[Command.REBOOT] = (0, lambda _data: one["front"].power_off())
    code, told = one("--yes")
    assert (code, told["reason"]) == (1, "front: was not seen to restart within 10 s: is it saved?")


@pytest.mark.parametrize("late", [False, True])
def test_ctrl_c_lets_it_go(tmp_path: Path, late: bool) -> None:
    """Also where it is calibrated by then: it is not saved, and no other turns."""
    one = Prepared(tmp_path)
    one("--yes")
    one.put(dict.fromkeys(CALIBRATED, 0.0))
    turning: list[int] = []

    def interrupt() -> None:
        """At its begin, or when it has told that it ended."""
        if one["front"].axis.state == FULL_CALIBRATION:
            turning.append(one.bench.now_ns)
        ended = bool(turning) and one.bench.now_ns > turning[-1] + 200 * MS
        if ended if late else len(turning) == 1:
            one.disturb = lambda: None
            signal.raise_signal(signal.SIGINT)

    one.disturb = interrupt
    code, told = one("--yes", "--calibrate")
    assert (code, told["reason"]) == (1, f"front: not calibrated: signal {signal.SIGINT.value}")
    assert one["front"].axis.state == 1
    assert one.bench.plant.angles[1:] == (0.0, 0.0)
    one["front"].power_cycle()
    assert one["front"].axis.parameters[CALIBRATED[0]] == 0.0
