"""Two controllers on one id are named soon, at rest and at speed; one rotor is never taken for two."""

from collections.abc import Callable, Iterator
from random import Random

import pytest

from drivers import DRIVERS
from drivers.contract import Driver, MotorSpec, MotorState
from drivers.setpoint import CommandKind, MotorCommand
from tests.drivers.rig import BUS, DRIVER_TYPES, MS, UNDER_CONTRACT, rig_of, spec

TOP = 100.0  # rad/s, of the specs
HZ = 250.0  # of the feedback
PERIOD = 1.0 / HZ
Reading = tuple[float, float, float]  # s, rad, rad/s
Line = Callable[[list[Reading], Random], list[Reading]]


def hear(unit: Driver, driver: str, reading: Reading, *, id: int = 3, variant: str = "") -> None:
    t, position, velocity = reading
    for said in rig_of(driver, variant).measurement(id, position, velocity):
        unit.receive(said._replace(received_ns=round(t * 1e9)))


def fault_after(driver: str, variant: str, readings: list[Reading]) -> int | None:
    """How many readings it takes until two controllers are told of; None: all of them are not enough."""
    unit = DRIVER_TYPES[driver](BUS, [spec(variant)])
    for number, reading in enumerate(readings, 1):
        hear(unit, driver, reading, variant=variant)
        if told(unit) is not None:
            return number
    return None


def told(unit: Driver) -> str | None:
    fault = unit.feedback(now_ns=0)[0].fault
    return None if fault is None else fault.text


def turning(speed: float, *, start: float = 0.0, at: float = 0.0, count: int = 500) -> list[Reading]:
    """A rotor at a constant speed, the first reading `at` of a period late."""
    times = [(index + at) * PERIOD for index in range(count)]
    return [(t, start + speed * t, speed) for t in times]


def together(*rotors: list[Reading]) -> list[Reading]:
    return sorted(reading for rotor in rotors for reading in rotor)


# A controller says the same in each of its modes, and one of them is slower than the others.
both = pytest.mark.parametrize(
    ("driver", "variant"), [pair for pair in UNDER_CONTRACT if spec(pair[1]).max_speed == TOP]
)


@both
@pytest.mark.parametrize("offset", [0.25, 1.0, -3.0])
def test_two_at_rest_are_named_with_their_fifth_return(driver: str, variant: str, offset: float) -> None:
    readings = together(turning(0.0), turning(0.0, start=offset, at=0.5))
    assert fault_after(driver, variant, readings) == 6  # one, the other, and four returns
    assert fault_after(driver, variant, together(turning(0.0), turning(0.0, start=0.15, at=0.5))) is None


@both
@pytest.mark.parametrize("speed", [2.0, 20.0, 100.0, -100.0])
@pytest.mark.parametrize("at", [0.01, 0.3, 0.5, 0.99])
def test_one_that_turns_and_one_that_stands(driver: str, variant: str, speed: float, at: float) -> None:
    number = fault_after(driver, variant, together(turning(speed), turning(0.0, start=1.5, at=at)))
    assert number is not None
    assert number <= 60


@both
def test_a_twin_that_reports_more_rarely(driver: str, variant: str) -> None:
    number = fault_after(driver, variant, together(turning(0.0), turning(0.0, start=1.0, at=0.5)[::5]))
    assert number is not None
    assert number <= 30


@both
def test_the_fault_names_id_and_bus_and_stays_until_it_is_cleared(driver: str, variant: str) -> None:
    unit = DRIVER_TYPES[driver](BUS, [spec(variant), spec(variant, id=5)])
    for said in rig_of(driver, variant).device(3, variant).answers([], 0):
        unit.receive(said)
    for reading in together(turning(0.0, count=10), turning(0.0, start=1.0, at=0.5, count=10)):
        hear(unit, driver, reading, variant=variant)
    for reading in turning(0.0, start=1.0, count=50):
        hear(unit, driver, reading, variant=variant)
    one, other = unit.feedback(now_ns=0)
    assert one.state is MotorState.FAULT
    assert one.fault is not None
    assert one.fault.code == "id_twin"
    assert one.fault.latched
    assert one.fault.text == "two controllers answer as id 3 on can0"
    assert other.fault is None
    unit.clear_faults()
    assert told(unit) is None
    for reading in turning(0.0, start=2.0, count=50):
        hear(unit, driver, reading, variant=variant)
    assert told(unit) is None


def test_the_rotor_of_a_dji_twin_is_neither_driven_nor_braked() -> None:
    unit = DRIVERS["dji"](BUS, [spec("c620")])
    for reading in turning(50.0, count=10):
        hear(unit, "dji", reading)
    now_ns = 40 * MS
    command = [MotorCommand(CommandKind.TORQUE, 1.0)]
    assert any(unit.command(command, now_ns=now_ns)[0].data)
    assert any(unit.stop_frames(now_ns=now_ns)[0].data)
    for reading in together(turning(50.0, count=30), turning(0.0, at=0.5, count=30)):
        hear(unit, "dji", reading)
    assert told(unit) is not None
    assert not any(unit.command(command, now_ns=now_ns)[0].data)
    assert not any(unit.stop_frames(now_ns=now_ns)[0].data)


# -- one rotor is one rotor -------------------------------------------------------------------------------------------


def rough_drive(chance: Random, count: int = 3000, *, top: float = TOP, period: float = PERIOD) -> Iterator[Reading]:
    """Full speeds both ways, hard ramps, and now and then an impact."""
    position = speed = 0.0
    target = rate = 0.0
    for index in range(count):
        if index % 100 == 0:
            target, rate = chance.choice([0.0, top, -top]), chance.choice([1.0, 8.0]) * top
        step = max(-rate * period, min(rate * period, target - speed))
        position += (speed + 0.5 * step) * period
        speed += step
        if chance.random() < 0.003:
            speed *= 0.3
        yield index * period, position + chance.uniform(-0.02, 0.02), speed


def lossy(readings: list[Reading], chance: Random) -> list[Reading]:
    return [one for one in readings if chance.random() > 0.5]


def repeated(readings: list[Reading], chance: Random) -> list[Reading]:
    """Every frame twice: as an echo at once, or as the copy of a repeater that the next one may overtake."""
    late = chance.choice([0.0, 1.5 * PERIOD])
    return sorted([*readings, *((t + late, position, speed) for t, position, speed in readings)])


def in_bursts(readings: list[Reading], chance: Random) -> list[Reading]:
    """An adapter holds frames back for up to 50 ms and hands them over at once, with one stamp."""
    held, taken = 0.0, []
    for t, position, speed in readings:
        if t > held:
            held = t + (chance.uniform(0.005, 0.05) if chance.random() < 0.05 else 0.0)
        taken.append((held, position, speed))
    return taken


def restarting(readings: list[Reading], chance: Random) -> list[Reading]:
    """Power cycles: the position starts anew, ten times."""
    begins = sorted(chance.sample(range(len(readings)), 10))
    origins = [0.0, *(readings[begin][1] for begin in begins)]
    places = [sum(begin <= index for begin in begins) for index in range(len(readings))]
    return [(t, p - origins[place], v) for (t, p, v), place in zip(readings, places, strict=True)]


def as_they_are(readings: list[Reading], _chance: Random) -> list[Reading]:
    return readings


@both
@pytest.mark.parametrize("line", [as_they_are, lossy, repeated, in_bursts, restarting])
@pytest.mark.parametrize("seed", range(5))
def test_one_rotor_is_never_two(driver: str, variant: str, line: Line, seed: int) -> None:
    chance = Random(seed)
    assert fault_after(driver, variant, line(list(rough_drive(chance)), chance)) is None


@both
def test_an_encoder_that_jumps_now_and_then_is_no_twin(driver: str, variant: str) -> None:
    readings = turning(0.0, count=3000)
    for index in range(20, len(readings), 20):
        readings[index] = (readings[index][0], 1.5, 0.0)
    assert fault_after(driver, variant, readings) is None


def test_a_whole_turn_at_any_angle_is_no_jump() -> None:
    """DJI counts 8192 to a turn: past the end it begins anew."""
    for speed in (1.0, -1.0, 30.0, -100.0):
        assert fault_after("dji", "c620", turning(speed, count=5000)) is None


def test_a_motor_of_omni4_at_its_top_speed_and_1_khz() -> None:
    fast = MotorSpec("m", 3, "c620", 864.0, 2.0, 20.0, 1000.0, 250.0, None)
    one, two = DRIVERS["dji"](BUS, [fast]), DRIVERS["dji"](BUS, [fast])
    for index in range(3000):
        moving = (index * 1e-3, 864.0 * index * 1e-3, 864.0)
        hear(one, "dji", moving)
        hear(two, "dji", moving)
        hear(two, "dji", (index * 1e-3 + 3e-4, 1.0, 0.0))
    assert told(one) is None
    assert told(two) is not None


@pytest.mark.parametrize("seed", range(10))
def test_one_fast_rotor_in_bursts_with_most_frames_lost(seed: int) -> None:
    """At top speed a DJI rotor is round within a few lost frames, and the stamps of a burst tell nothing."""
    chance = Random(seed)
    unit = DRIVERS["dji"](BUS, [MotorSpec("m", 3, "c620", 864.0, 2.0, 20.0, 1000.0, 250.0, None)])
    readings = list(rough_drive(chance, 6000, top=864.0, period=1e-3))
    for reading in in_bursts([one for one in readings if chance.random() > 0.7], chance):
        hear(unit, "dji", reading)
    assert told(unit) is None
