"""Another id for a controller: two fresh ones told apart, kept over a power cut, and by hand what the bus shows."""

import json
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from io import StringIO
from typing import cast
from unittest.mock import patch

import pytest
import typer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers import DRIVERS
from drivers.contract import CanFrame, Identity, RenamingOverCan
from gateway.cli.app import build
from gateway.config import parse
from gateway.edges.claims import Claims, InUseError
from gateway.setup.renaming import KINDS, IdWatch, RenamingError, RestWatch, way
from replay.sim.controllers.odrive import SimulatedODrive
from tests.drivers.rig import can_frame
from tests.gateway.test_setup_inputs import CHANNEL, Terminal, Told, simulated
from tests.jogging import MS, Bench
from tests.setup_robots import TRUE, wronged
from tests.world import robot_text

SERIAL = 0x385F324D3037  # of the twin


def fresh() -> tuple[Bench, SimulatedODrive, SimulatedODrive]:
    """A robot on whose bus two ODrives are as they left the factory."""
    bench = Bench(parse(wronged(TRUE["kiwi"](), {"front": 0}, {}), "kiwi"))
    bench.bus.add_twin("front", 1.0)
    one = cast("SimulatedODrive", bench.bus.robot.devices["front"])
    twin, _ = bench.bus.robot._twins["front"]
    other = cast("SimulatedODrive", twin)
    other.serial = SERIAL
    return bench, one, other


def called(
    bench: Bench,
    *arguments: str,
    typed: tuple[str, ...] = (),
    terminal: bool = False,
    disturb: Callable[[Bench], None] = lambda _: None,
    channel: str = CHANNEL,
) -> tuple[int, dict[str, object]]:
    out, code = StringIO(), 0
    stdin = patch.object(sys, "stdin", Terminal(typed, terminal=terminal))
    with simulated(bench, Told(), disturb), stdin, redirect_stdout(out), suppress(typer.Exit):
        code = 1
        code = build("setup")(["setup", "id", channel, *arguments, "--json"], standalone_mode=False) or 0
    return code, json.loads(out.getvalue())


def test_two_fresh_odrives_are_told_apart_and_keep_their_ids() -> None:
    bench, one, other = fresh()
    code, found = called(bench, "odrive-0.6")
    assert (code, found["shared"]) == (1, [0])
    assert set(cast("dict[str, int]", found["ids"])) >= {f"{one.serial:012X}", f"{SERIAL:012X}"}
    code, found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{SERIAL:X}", "--yes")
    assert (code, found) == (0, {"ok": True, "serial": f"{SERIAL:012X}", "from": 0, "to": 7})
    assert (one.node, other.node) == (0, 7)
    for device in (one, other):
        device.power_cycle()
    assert (one.node, other.node) == (0, 7)
    assert bench.plant.angles == (0.0, 0.0, 0.0)
    assert called(bench, "odrive-0.6")[1]["shared"] == []


def test_which_one_has_to_be_said() -> None:
    bench, one, other = fresh()
    code, found = called(bench, "odrive-0.6", "--to", "7", "--yes")
    assert (code, found["ok"]) == (1, False)
    assert "--serial is missing: 4 are there" in str(found["reason"])
    assert "not there" in str(called(bench, "odrive-0.6", "--to", "7", "--serial", "12", "--yes")[1]["reason"])
    assert "hexadecimal" in str(called(bench, "odrive-0.6", "--to", "7", "--serial", "x", "--yes")[1]["reason"])
    assert (one.node, other.node) == (0, 0)


def test_an_id_that_another_has_is_not_taken_from_it() -> None:
    bench, one, other = fresh()
    found = called(bench, "odrive-0.6", "--to", "2", "--serial", f"{SERIAL:X}", "--yes")[1]
    assert "id 2 is that of serial" in str(found["reason"])
    assert (one.node, other.node) == (0, 0)


def test_nor_from_one_that_tells_no_serial() -> None:
    """As firmware 0.5: it would be started anew in the other's place."""
    bench, one, _ = fresh()
    silent = cast("SimulatedODrive", bench.bus.robot.devices["rear_left"])
    silent._reports.pop(6)
    found = called(bench, "odrive-0.6", "--to", str(silent.node), "--serial", f"{one.serial:X}", "--yes")[1]
    assert "which tells no serial" in str(found["reason"])
    assert one.node == 0


def test_one_that_drives_is_not_started_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """And nobody is asked."""
    asked: list[object] = []
    monkeypatch.setattr("gateway.cli.setup_id.allow", lambda *_, **__: asked.append(1))
    bench, _, other = fresh()
    bench.bus.remove_twin("front")
    front = cast("SimulatedODrive", bench.bus.robot.devices["front"])
    front.axis.request(8)
    found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{front.serial:X}")[1]
    assert "is CLOSED_LOOP_CONTROL: let it go first" in str(found["reason"])
    assert (front.node, other.node, asked) == (0, 0, [])


@pytest.mark.parametrize("late_ms", [0, 3, 30, 70])
@pytest.mark.parametrize("armed", [0, 1])
def test_nor_where_either_of_two_of_one_id_drives(armed: int, late_ms: int) -> None:
    """Whichever of them was heard last."""
    bench, *both = fresh()
    for _, clock in both[1]._clocks:
        clock.due_ns += late_ms * MS
    bench.wait(0.05)
    both[armed].axis.request(8)
    found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{SERIAL:X}", "--yes")[1]
    assert "is CLOSED_LOOP_CONTROL: let it go first" in str(found["reason"])
    assert [(device.node, device.axis.state) for device in both] == [(0, 8 if at == armed else 1) for at in (0, 1)]


def test_nor_where_somebody_commands_it() -> None:
    """From another computer, whose claims are not seen here."""
    bench, *both = fresh()
    bench.bus.babble("can0", CanFrame("can0", 0x00D, bytes(8)), rate_hz=50.0)
    found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{SERIAL:X}", "--yes")[1]
    assert "is commanded by somebody: let it go first" in str(found["reason"])
    assert [device.node for device in both] == [0, 0]


def test_nor_where_it_does_not_tell_its_state() -> None:
    watch = RestWatch("odrive")
    with pytest.raises(RenamingError, match="does not tell"):
        watch.check(Identity(SERIAL, 0))
    watch.check(Identity(SERIAL, None))
    watch.take(can_frame("001#0000000001000000"))
    watch.check(Identity(SERIAL, 0))


@pytest.mark.parametrize("armed", [0, 1])
def test_one_that_is_armed_before_the_yes_is_left_alone(armed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, *both = fresh()
    monkeypatch.setattr("gateway.cli.setup_id.allow", lambda *_, **__: both[armed].axis.request(8))
    found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{SERIAL:X}")[1]
    assert "is CLOSED_LOOP_CONTROL: let it go first" in str(found["reason"])
    assert [(device.node, device.axis.state) for device in both] == [(0, 8 if at == armed else 1) for at in (0, 1)]
    assert all(frame.remote for _, frame in bench.sent)


def test_a_gateway_that_began_before_the_yes_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever it commands there."""
    bench, *both = fresh()
    claims: list[Claims] = []
    begin = lambda *_, **__: claims.append(Claims("socketcan", "began_id", [0x7FF]))  # noqa: E731
    monkeypatch.setattr("gateway.cli.setup_id.allow", begin)
    with pytest.raises(InUseError):
        called(bench, "odrive-0.6", "--to", "7", "--serial", f"{SERIAL:X}", channel="began_id")
    claims[0].release()
    assert [device.node for device in both] == [0, 0]


def test_one_that_does_not_take_it_is_told() -> None:
    bench, one, _ = fresh()
    one._handlers.pop(6)
    found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{one.serial:X}", "--yes")[1]
    assert "tells id 0 instead of 7" in str(found["reason"])
    assert [frame for _, frame in bench.sent if frame.id & 0x1F == 0x16] == []  # nobody starts anew


def test_one_that_forgets_it_is_told() -> None:
    bench, one, _ = fresh()
    one._reboot = one._handlers[0x16] = (0, lambda _data: one.power_cycle())  # type: ignore[assignment, method-assign]
    found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{one.serial:X}", "--yes")[1]
    assert "tells id 0 instead of 7" in str(found["reason"])


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    to=st.integers(-2, 70),
    serial=st.sampled_from([None, f"{SERIAL:X}", "0", "zz"]),
    lines=st.lists(st.sampled_from(["y", "no", "", "Yes", "7"]), max_size=3).map(tuple),
    terminal=st.booleans(),
)
def test_without_a_yes_no_id_changes_and_nothing_moves(
    to: int, serial: str | None, lines: tuple[str, ...], terminal: bool
) -> None:
    bench, one, other = fresh()
    which = [] if serial is None else ["--serial", serial]
    code, _ = called(bench, "odrive-0.6", f"--to={to}", *which, typed=lines, terminal=terminal)
    assert code != 0
    assert (one.node, other.node) == (0, 0)
    assert all(frame.remote for _, frame in bench.sent)
    assert set(bench.plant.angles) == {0.0}


def test_a_gateway_on_the_bus_is_left_alone() -> None:
    bench, _, _ = fresh()
    claims = Claims("socketcan", "held_id", [0x7FF])
    with pytest.raises(InUseError):
        called(bench, "odrive-0.6", channel="held_id")
    claims.release()
    assert bench.sent == []


def test_no_gateway_begins_while_an_id_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the yes on: it would drive what is then started anew."""
    bench, _, _ = fresh()
    allowed: list[bool] = []
    monkeypatch.setattr("gateway.cli.setup_id.allow", lambda *_, **__: allowed.append(True))
    free: dict[int, list[bool]] = {0x007: [], 0x0E7: []}

    def begin(bench: Bench) -> None:
        for identifier, found in free.items():
            if not allowed:
                continue
            try:
                Claims("socketcan", "renamed", [identifier]).release()
                found.append(True)
            except InUseError:
                found.append(False)

    code, _ = called(
        bench, "odrive-0.6", "--to", "7", "--serial", f"{SERIAL:X}", "--yes", disturb=begin, channel="renamed"
    )
    assert code == 0
    assert {identifier: set(found) for identifier, found in free.items()} == {0x007: {False}, 0x0E7: {False}}
    Claims("socketcan", "renamed", free).release()


def test_one_that_still_knew_it_before_it_started_anew_is_told() -> None:
    bench, one, _ = fresh()
    told_ns: list[int] = []
    one._handlers[0x16] = (0, lambda _data: told_ns.append(bench.now_ns))

    def forget(bench: Bench) -> None:
        if told_ns and bench.now_ns > told_ns[0] + 300 * MS:
            one.power_cycle()

    found = called(bench, "odrive-0.6", "--to", "7", "--serial", f"{one.serial:X}", "--yes", disturb=forget)[1]
    assert "tells id 0 instead of 7" in str(found["reason"])


# -- by hand ----------------------------------------------------------------------------------------------------------

BY_HAND = {
    "c620": ("omni4", "front_left"),
    "gm6020": ("omni4_gm6020", "front_left"),
    "vesc": ("omni4_vesc", "front_left"),
}


def by_hand(kind: str, to: int, really: int) -> tuple[Bench, tuple[int, dict[str, object]], int]:
    """While the bus is watched a person gives the first motor this id."""
    robot, motor = BY_HAND[kind]
    bench = Bench(parse(robot_text(robot), robot))
    device, begun_ns = bench.bus.robot.devices[motor], bench.now_ns
    before = device.setup.id

    def set_it(bench: Bench) -> None:
        if bench.now_ns > begun_ns + 4_000_000_000:
            device.setup = device.setup._replace(id=really)  # type: ignore[misc]

    return bench, called(bench, kind, "--to", str(to), disturb=set_it), before


@pytest.mark.parametrize("kind", BY_HAND)
def test_the_id_that_went_and_the_one_that_came(kind: str) -> None:
    bench, (code, found), before = by_hand(kind, 5, 5)
    assert (code, found) == (0, {"ok": True, "came": [5], "went": [before], "to": 5})
    assert all(frame.extended for _, frame in bench.sent)  # pings of VESCs


def test_another_one_than_was_meant_is_told() -> None:
    _, (code, found), before = by_hand("c620", 5, 6)
    assert (code, found) == (1, {"ok": False, "came": [6], "went": [before], "to": 5})


def test_an_id_that_is_taken_is_not_set() -> None:
    _, (code, found), _ = by_hand("c620", 2, 2)
    assert (code, "id 2 is taken" in str(found["reason"])) == (1, True)


def test_nothing_that_happens_is_told() -> None:
    _, (code, found), before = by_hand("c620", 5, 1)
    assert before == 1
    assert (code, "no new id was heard" in str(found["reason"])) == (1, True)


def test_one_frame_is_no_id() -> None:
    watch = IdWatch("dji", "c620")
    watch.begin()
    watch.take(can_frame("205#1000F1F0F99A2900", received_ns=1))
    assert watch.ids() == frozenset()


def test_what_somebody_sends_to_an_id_is_not_heard_from_it() -> None:
    watch = IdWatch("vesc", "vesc")
    watch.begin()
    for at in range(1, 9):
        watch.take(can_frame("00000009#00000000", received_ns=at))  # duty of id 9
    assert watch.ids() == frozenset()


# -- of the protocols -------------------------------------------------------------------------------------------------


def test_every_controller_has_a_way() -> None:
    assert set(KINDS.values()) == {(name, variant) for name, of in DRIVERS.items() for variant in of.variants}
    for kind, (driver, variant) in KINDS.items():
        ids, how = DRIVERS[driver].renaming(variant)
        if not isinstance(how, RenamingOverCan):
            assert all(any(str(at) in step or "on" in step for step in how(at)) for at in ids)
        with pytest.raises(RenamingError, match=f"has an id of {ids.start} to"):
            way(kind, ids.stop)
    with pytest.raises(RenamingError, match="must be one of"):
        way("odrive", 3)


def test_the_switches_of_a_gm6020_are_its_id_in_binary() -> None:
    steps = DRIVERS["dji"].renaming("gm6020").how
    assert not isinstance(steps, RenamingOverCan)
    assert "1 on, 2 off, 3 on;" in steps(5)[1]
    assert {steps(at)[1] for at in range(1, 8)} == {steps(at)[1] for at in range(1, 8)}
    assert len({steps(at)[1] for at in range(1, 8)}) == 7


def odrive() -> RenamingOverCan:
    how = DRIVERS["odrive"].renaming("0.6").how
    assert isinstance(how, RenamingOverCan)
    return how


def test_frames_of_an_odrive() -> None:
    how = odrive()
    (ask,) = how.ask("can0")
    assert (ask.id, ask.remote, ask.data) == (0x7E6, True, b"")
    assert how.give("can0", SERIAL, 5) == [can_frame("7E6#0537304D325F38")._replace(bus="can0", received_ns=None)]
    assert how.keep("can0", 5) == [can_frame("0B6#01")._replace(bus="can0", received_ns=None)]
    assert how.told(can_frame("006#0037304D325F38")) == Identity(SERIAL, 0)
    assert how.told(can_frame("0A6#0537304D325F3801")) == Identity(SERIAL, 5)
    assert how.told(can_frame("7E6#3F37304D325F38")) == Identity(SERIAL, None)


@pytest.mark.parametrize(
    "text", ["7E6#0537304D325F38", "0A6#0637304D325F38", "0A6#053730", "0A6#R", "0A9#0537304D325F38"]
)
def test_what_is_no_answer_of_an_odrive(text: str) -> None:
    assert odrive().told(can_frame(text)) is None
