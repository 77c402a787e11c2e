"""Who is on a bus, against simulated controllers and against frames made by hand."""

from collections.abc import Callable, Collection, Iterable
from struct import pack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import DRIVERS
from drivers.contract import CanFrame
from drivers.sighting import Evidence
from gateway.config import parse
from gateway.setup.bit_rate import Link, words
from gateway.setup.census import Census, Report, alternate
from gateway.setup.match import match
from replay.sim.bus import SimulatedBus
from tests.drivers.rig import can_frame
from tests.world import BUNDLED, robot_text

MS = 1_000_000
FIRST_NS = 1_000_000_000_000


def heard(
    name: str,
    *,
    disturb: Callable[[SimulatedBus], None] = lambda _: None,
    ask: bool = False,
    known: Collection[tuple[str, str, int]] = (),
) -> Report:
    """After 2 s beside this simulated robot."""
    bus, census = SimulatedBus(parse(robot_text(name), name)), Census()
    bus.receive(FIRST_NS)
    disturb(bus)
    for cycle in range(1, 501):
        now_ns = FIRST_NS + cycle * 4 * MS
        census.take(bus.receive(now_ns)[0])
        if ask and cycle == 250:
            for driver in DRIVERS:
                for frame in DRIVERS[driver].questions("can0", census.heard(driver)):
                    now_ns += MS
                    census.take(bus.receive(now_ns)[0])
                    bus.send([frame], now_ns)
    return census.report(2.0, known)


def of(frames: Iterable[CanFrame]) -> Report:
    census = Census()
    census.take(frames)
    return census.report(1.0)


@pytest.mark.parametrize("name", BUNDLED)
def test_every_controller_of_a_robot_is_found_and_no_other(name: str) -> None:
    config = parse(robot_text(name), name)
    report = heard(name, known=[(motor.driver, motor.variant, motor.id) for motor in config.motor])
    motors = {(motor.driver, motor.id) for motor in config.motor}
    found = {(one.driver, one.id) for one in report.found}
    senders = {sensor.id for sensor in config.sensor if sensor.bus is not None}
    assert motors <= found
    assert report.conflicts == ()
    assert found == motors
    assert len(report.commanded) <= len(senders)  # what a sensor says may be a host's word to an ODrive
    assert len(report.unknown) + len(report.commanded) >= len(senders)
    assert match(config, report.found) == (tuple(motor.name for motor in config.motor), (), ())


def test_what_they_tell() -> None:
    (left, *_) = heard("moby", ask=True).found
    assert (left.driver, left.variants, left.id) == ("odrive", ("0.6",), 1)
    assert dict(left.told) == {"state": "IDLE", "firmware": "0.6.10", "hardware": "0.0.0"}
    assert left.rate_hz == pytest.approx(10.0, rel=0.01)
    assert not left.commanded


def test_an_error_is_told_in_words() -> None:
    def break_left(bus: SimulatedBus) -> None:
        bus.robot.devices["left"].raise_error(0x0100_0200)  # type: ignore[attr-defined]

    (left, *_) = heard("moby", disturb=break_left).found
    assert dict(left.told)["error"] == "DC_BUS_UNDER_VOLTAGE, WATCHDOG_TIMER_EXPIRED"


def test_vescs_that_send_no_status_answer_a_ping() -> None:
    def silence(bus: SimulatedBus) -> None:
        for device in bus.robot.devices.values():
            device._clocks = ()  # type: ignore[attr-defined]

    assert heard("omni4_vesc", disturb=silence).found == ()
    assert [one.id for one in heard("omni4_vesc", disturb=silence, ask=True).found] == [1, 2, 3, 4]


@pytest.mark.parametrize(("name", "motor"), [("moby", "left"), ("omni4", "front_left"), ("omni4_vesc", "front_left")])
def test_two_of_one_id_are_seen_where_they_stand_apart(name: str, motor: str) -> None:
    report = heard(name, disturb=lambda bus: bus.add_twin(motor, 1.0))
    assert any("id 1: their angles take turns" in words for words in report.conflicts)


def test_two_of_one_id_that_stand_alike_are_seen_by_their_rhythm() -> None:
    def add(bus: SimulatedBus) -> None:
        bus.receive(FIRST_NS + 30 * MS)
        bus.add_twin("left", 0.0)

    (words,) = heard("moby", disturb=add).conflicts
    assert words == "two controllers seem to answer as odrive id 1: frames come in two rhythms"


@given(st.floats(5.0, 200.0), st.floats(0.0, 0.05), st.integers(0, 3))
def test_one_clock_is_never_two(period_ms: float, jitter: float, lost: int) -> None:
    stamps = [round((n * period_ms + (jitter * period_ms if n % 3 else 0.0)) * MS) for n in range(40)]
    del stamps[10 : 10 + lost]
    assert not alternate(stamps)


@given(st.floats(11.0, 200.0), st.floats(0.1, 0.35))
def test_two_clocks_are_two(period_ms: float, phase: float) -> None:
    first = [round(n * period_ms * MS) for n in range(20)]
    second = [round((n + phase) * period_ms * MS) for n in range(20)]
    assert alternate(sorted([*first, *second]))


def test_an_id_of_two_kinds_of_one_protocol_is_a_conflict() -> None:
    frames = [CanFrame("can0", 0x205, pack(">HhhBB", 100, 0, 0, 30, 0), received_ns=n * MS) for n in range(50)]
    report = of(frames)
    assert [one.name for one in report.found] == ["dji gm6020 id 1", "dji c620 id 5"]
    (conflict,) = report.conflicts
    assert conflict.startswith("0x205 may be of dji gm6020 id 1 or dji c620 id 5")


def test_an_id_of_two_protocols_is_a_conflict() -> None:
    """A heartbeat of node 16 is what a C610 of id 1 would say too."""
    report = of(can_frame("201#0000000001000000", received_ns=n * 100 * MS) for n in range(20))
    (conflict,) = report.conflicts
    assert conflict.startswith("0x201 may be of dji c610 id 1 or odrive 0.5/0.6 id 16")


def test_what_nobody_knows_is_named_and_what_a_host_says_is_not() -> None:
    frames = [
        can_frame(text, received_ns=n * MS) for n in range(9) for text in ("7A5#11", "1ABCDE01#22", "027#08000000")
    ]
    report = of(frames)
    assert [(one.can_id, one.extended, one.data) for one in report.unknown] == [
        (0x7A5, False, b"\x11"),
        (0x1ABCDE01, True, b"\x22"),
    ]
    assert report.found == ()
    assert report.commanded == ("0x27 would command odrive id 1, which does not answer; or nobody knows it",)


@given(st.lists(st.tuples(st.integers(0, 0x1FFFFFFF), st.binary(max_size=8), st.booleans(), st.booleans())))
def test_wild_frames_never_raise(wild: list[tuple[int, bytes, bool, bool]]) -> None:
    frames = [
        CanFrame("can0", at if extended else at & 0x7FF, b"" if remote else data, extended, remote, n * MS)
        for n, (at, data, extended, remote) in enumerate(wild)
    ]
    assert of(frames).frames == len(frames)


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_a_sighting_is_of_its_driver(at: int, data: bytes) -> None:
    for name, driver in DRIVERS.items():
        for sighting in driver.sighted(CanFrame("can0", at, data, received_ns=0)):
            assert sighting.driver == name
            assert set(sighting.variants) <= set(driver.variants)


@pytest.mark.parametrize("name", BUNDLED)
def test_what_a_driver_sends_is_seen_as_a_command_and_its_questions_move_nothing(name: str) -> None:
    config = parse(robot_text(name), name)
    for driver in {motor.driver for motor in config.motor}:
        motors = [motor for motor in config.motor if motor.driver == driver]
        questions = DRIVERS[driver].questions("can0", [motor.id for motor in motors])
        for frame in questions:
            assert all(one.evidence is not Evidence.COMMAND for one in DRIVERS[driver].sighted(frame))


HEALTHY = Link(up=True, virtual=False, bitrate=250_000, state="ERROR-ACTIVE", errors=(0, 0))


@pytest.mark.parametrize(
    ("link", "frames", "errors", "expected"),
    [
        (HEALTHY, 9, {}, "bit rate 250000 bit/s: right, frames pass"),
        (HEALTHY, 0, {}, "nothing was heard, so nobody can say"),
        (HEALTHY._replace(state="ERROR-PASSIVE", errors=(0, 128)), 0, {}, "is probably wrong"),
        (HEALTHY, 0, {"controller is bus-off": 3}, "is probably wrong"),
        (HEALTHY._replace(errors=(0, 7)), 9, {}, "look at cable and termination"),
        (HEALTHY._replace(up=False), 0, {}, "ip link set can0 up type can bitrate RATE"),
        (HEALTHY._replace(virtual=True), 0, {}, "is virtual"),
    ],
)
def test_bit_rate(link: Link, frames: int, errors: dict[str, int], expected: str) -> None:
    said = words(link, "can0", frames=frames, errors=errors)
    assert expected in said[-1]


def test_bit_rate_of_other_adapters_is_not_judged() -> None:
    assert words(None, "can0", frames=3, errors={}) == []
