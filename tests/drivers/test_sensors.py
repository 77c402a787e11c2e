"""What every entry of SENSORS must hold, heard from its simulated twin, which is written from the README alone."""

from math import pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.checks import id_conflicts
from drivers.contract import CanFrame
from drivers.sensors import SENSORS, sensor_problem
from drivers.sensors.contract import Heard, SensorDriver, SensorSpec
from drivers.sensors.counted import checksum
from gateway.types import Attitude
from replay.sim import robot
from replay.sim.sensors.contract import Scene, SensorSetup
from replay.sim.sensors.sender import Sender, crc8_j1850
from tests.drivers.rig import BUS, MS, can_frame

PAIRS = [(driver, kind) for driver, made in SENSORS.items() for kind in made.kinds]
every_kind = pytest.mark.parametrize(("driver", "kind"), PAIRS)
SCENE = Scene(0.4321, Attitude(0.1, -0.2, 0.3, -0.4, 0.5), 7.0)
ID = 0x120
STEPS = {"range": 1e-6, "attitude": 1e-3, "heading": 1e-4}


def made(driver: str, kind: str, *, at: int = ID) -> SensorDriver:
    return SENSORS[driver].make(BUS, SensorSpec("sensor", at, kind, 100.0))


def quiet(driver: str, *, at: int = ID) -> Sender:
    """A twin that tells the truth, at once."""
    twin = robot.SENSORS[driver](SensorSetup("sensor", BUS, at, 100.0))
    for signal in twin.signals.values():
        signal.noise = [0.0] * len(signal.noise)
        signal.delay_ns = 0
    twin.start(SCENE, 0)
    return twin


def frames(twin: Sender, until_ms: int, scene: Scene = SCENE) -> list[CanFrame]:
    said = []
    for ms in range(until_ms):
        twin.step(scene, ms * MS)
        said += [one.frame._replace(received_ns=one.ready_ns) for one in twin.poll(ms * MS)]
    return said


def heard(port: SensorDriver, said: list[CanFrame]) -> list[Heard]:
    found = [port.receive(frame) for frame in said]
    assert None not in found
    return [one for one in found if one is not None]


def test_every_driver_has_a_twin() -> None:
    assert set(robot.SENSORS) == set(SENSORS)
    assert {kind for _, kind in PAIRS} == {"range", "attitude", "heading"}


@every_kind
def test_names_are_explained(driver: str, kind: str) -> None:
    assert sensor_problem(driver, kind) is None
    assert kind in (sensor_problem(driver, "smell") or "")
    assert driver in (sensor_problem("nose", kind) or "")


@every_kind
@pytest.mark.parametrize("at", [0, ID, 0x7FE, 0x800, 0x1FFF_FFFE])
def test_it_hears_what_its_twin_tells(driver: str, kind: str, at: int) -> None:
    said = frames(quiet(driver, at=at), 100)
    told = [one for one in heard(made(driver, kind, at=at), said) if one.values is not None]
    assert 9 <= len(told) <= 11
    truth = {"heading": (7.0 - 2 * pi,)}.get(kind, SCENE.of(kind))
    for one in told:
        assert one.values == pytest.approx(truth, abs=0.51 * STEPS[kind])
    assert [one.measured_ns for one in told] == sorted({frame.received_ns or 0 for frame in said})


@every_kind
def test_what_is_sent_is_declared_and_let_pass(driver: str, kind: str) -> None:
    port, said = made(driver, kind), frames(quiet(driver), 30)
    for frame in said:
        assert any(not (use.id ^ frame.id) & use.mask and use.extended == frame.extended for use in port.ids())
        passes = [wanted.extended == frame.extended for wanted in port.receive_filters() if wanted.id == frame.id]
        assert passes == [True]
    assert {item.length for item in port.traffic()} == {len(frame.data) for frame in said}
    assert len(port.traffic()) == len({frame.id for frame in said})
    assert all(item.rate_hz == 100.0 and not item.extended for item in port.traffic())
    assert id_conflicts([port.ids(), port.ids()])[0].startswith("sensor sensor (0x120)")


@every_kind
def test_frames_in_words(driver: str, kind: str) -> None:
    port, said = made(driver, kind), frames(quiet(driver), 12)
    words = [port.decode(frame) for frame in said]
    assert all(one is not None and one.motor == "sensor" for one in words)
    names = {name for one in words if one for name, _ in one.fields}
    assert {"count", "state"} < names
    assert port.decode(said[0]._replace(data=said[0].data[:-1])) is None
    assert port.decode(said[0]._replace(id=0x300)) is None
    assert port.decode(said[0]._replace(data=bytes([said[0].data[0] ^ 1, *said[0].data[1:]]))) is None


@every_kind
def test_a_sender_that_hangs_is_seen(driver: str, kind: str) -> None:
    twin, port = quiet(driver), made(driver, kind)
    heard(port, frames(twin, 20))
    twin.hang(True)
    twin.poll(20 * MS)
    said = [one.frame._replace(received_ns=one.ready_ns) for one in twin.poll(200 * MS)]
    assert {one.flaw for one in heard(port, said)} == {"its counter stands still"}
    twin.hang(False)
    again = [one.frame._replace(received_ns=one.ready_ns) for one in twin.poll(220 * MS)]
    assert any(one.values for one in heard(port, again))


@every_kind
def test_one_that_sticks_goes_on_counting_and_is_heard(driver: str, kind: str) -> None:
    """The driver cannot know: a robot at rest tells the same for ever too."""
    twin, port = quiet(driver), made(driver, kind)
    heard(port, frames(twin, 20))
    twin.stick(True)
    moved = Scene(0.5, Attitude(0.0, 0.0, 0.0, 0.0, 0.0), 0.0)
    told = [one.values for one in heard(port, frames(twin, 20, moved)) if one.values]
    assert all(
        values == pytest.approx(SCENE.of(kind) if kind != "heading" else (7.0 - 2 * pi,), abs=1e-3) for values in told
    )


@every_kind
@pytest.mark.parametrize(("state", "words"), [(1, "not begun"), (2, "out of its range"), (3, "fault"), (9, "state 9")])
def test_a_state_of_its_own_is_no_measurement(driver: str, kind: str, state: int, words: str) -> None:
    port = made(driver, kind)
    for frame in frames(quiet(driver), 15):
        data = bytes([*frame.data[:-2], state << 4 | frame.data[-2]])
        told = port.receive(frame._replace(data=data + bytes([checksum(frame.id, data)])))
        assert told is not None
        assert told.values is None
        assert words in (told.flaw or "")


@every_kind
def test_damage_is_seen_in_every_bit(driver: str, kind: str) -> None:
    for frame in frames(quiet(driver), 12):
        for bit in range(8 * len(frame.data)):
            flipped = (int.from_bytes(frame.data, "big") ^ 1 << bit).to_bytes(len(frame.data), "big")
            assert (
                heard(made(driver, kind), [frame._replace(data=flipped)])[0].flaw
                == "its frames are damaged (wrong checksum)"
            )


@every_kind
def test_what_is_not_its_own_is_left(driver: str, kind: str) -> None:
    port = made(driver, kind)
    frame = frames(quiet(driver), 12)[0]
    foreign = [
        *(frame._replace(bus="can9"), frame._replace(extended=True), frame._replace(remote=True, data=b"")),
        *(frame._replace(fd=True), frame._replace(id=0x7FF), frame._replace(received_ns=None)),
        *(frame._replace(data=frame.data[:-1]), frame._replace(data=frame.data + b"\0")),
    ]
    assert [port.receive(one) for one in foreign] == [None] * len(foreign)


@every_kind
@given(st.lists(st.tuples(st.integers(0x11F, 0x123), st.binary(max_size=8), st.booleans()), max_size=12))
def test_no_bytes_raise(driver: str, kind: str, given_: list[tuple[int, bytes, bool]]) -> None:
    port = made(driver, kind)
    for place, (at, data, whole) in enumerate(given_):
        body = data + bytes([checksum(at, data)]) if whole and len(data) < 8 else data
        frame = CanFrame(BUS, at, body, received_ns=place)
        port.decode(frame)
        told = port.receive(frame)
        assert told is None or told.values is None or told.flaw is None


@pytest.mark.parametrize(
    ("driver", "at", "allowed"),
    [
        ("imu", 0x7FF, "0 to 0x7FE, or, extended, 0x800 to 0x1FFFFFFE: it sends 2 ids"),
        ("imu", 0x1FFF_FFFF, "0x1FFFFFFE"),
        ("draw_wire", 0x2000_0000, "0 to 0x7FF, or, extended, 0x800 to 0x1FFFFFFF: it sends 1 ids"),
    ],
)
def test_ids_out_of_range_are_refused_with_the_range(driver: str, at: int, allowed: str) -> None:
    with pytest.raises(ValueError, match=f"sensor sensor: id = {at}: must be .*{allowed}"):
        made(driver, SENSORS[driver].kinds[0], at=at)


# frame by frame


def test_the_checksum_is_that_of_the_standard() -> None:
    """0x4B is the check value of CRC-8/SAE-J1850; the driver's own covers the id besides."""
    assert crc8_j1850(b"123456789") == 0x4B
    assert checksum(0x3433_3231, b"56789") == 0x4B


def test_a_length_by_hand() -> None:
    """0.4 m are 400000 um, 0x00061A80."""
    port = made("draw_wire", "range")
    data = bytes.fromhex("801A060005")
    frame = can_frame(f"120#{data.hex()}{checksum(ID, data):02X}", received_ns=77)
    assert port.receive(frame) == Heard((0.4,), None, 77)
    assert port.receive(frame) == Heard(flaw="its counter stands still")
    words = port.decode(frame)
    assert words is not None
    assert words.fields == (("length", 0.4), ("count", 5), ("state", 0))
    untold = bytes.fromhex("FFFFFFFF06")
    told = port.receive(can_frame(f"120#{untold.hex()}{checksum(ID, untold):02X}", received_ns=78))
    assert told == Heard(flaw="it does not tell its range")


def imu_frame(place: int, count: int, *numbers: int, received_ns: int = 5) -> CanFrame:
    data = b"".join(number.to_bytes(2, "little", signed=True) for number in numbers) + bytes([count])
    return CanFrame(BUS, ID + place, data + bytes([checksum(ID + place, data)]), received_ns=received_ns)


def test_both_frames_of_an_imu_make_one_measurement_of_the_first_ones_time() -> None:
    port = made("imu", "attitude")
    assert port.receive(imu_frame(0, 3, 100, -200, 300)) == Heard()
    told = port.receive(imu_frame(1, 3, 1000, -32768, 3, received_ns=6))
    assert told == Heard((0.01, -0.02, 1.0, None, 0.003), None, 5)


def test_half_a_measurement_is_none() -> None:
    port = made("imu", "attitude")
    missing = Heard(flaw="some of its frames are missing")
    assert port.receive(imu_frame(1, 3, 0, 0, 0)) == missing, "its angles are missing"
    assert port.receive(imu_frame(0, 4, 1, 2, 3)) == Heard()
    assert port.receive(imu_frame(0, 5, 1, 2, 3)) == missing, "rates 4 are missing"
    assert port.receive(imu_frame(1, 6, 0, 0, 0)) == missing, "angles 6 are missing"
    assert port.receive(imu_frame(0, 7, 1, 2, 3)) == Heard()
    assert port.receive(imu_frame(1, 7, 0, 0, 0)) == Heard((1e-4, 2e-4, 0.0, 0.0, 0.0), None, 5)


def test_an_imu_without_rates_tells_its_angles_and_one_without_angles_nothing() -> None:
    lean, gyro = made("imu", "attitude"), made("imu", "heading")
    said = [imu_frame(0, 1, 10, 20, -32768), imu_frame(1, 1, -32768, -32768, -32768)]
    assert heard(lean, said)[-1] == Heard((1e-3, 2e-3, None, None, None), None, 5)
    assert heard(gyro, said)[-1] == Heard(flaw="it does not tell its heading")
    said = [imu_frame(0, 2, -32768, 20, 30), imu_frame(1, 2, 0, 0, 0)]
    assert heard(lean, said)[-1] == Heard(flaw="it does not tell its attitude")
    assert heard(gyro, said)[-1] == Heard((3e-3,), None, 5)
