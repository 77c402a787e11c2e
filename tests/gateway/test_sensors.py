"""Sensors that do not come over CAN: what is believed of them, what becomes of the pose, and the replay of it."""

from collections.abc import Iterable
from math import pi
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.cli.simulation import sensing, together
from gateway.client import Client
from gateway.config import ConfigError, Sensor, parse
from gateway.core.engine import Engine
from gateway.core.sensors import Heading, Sensors
from gateway.types import Attitude, Inputs, SensorKind, SensorSample, Twist
from tests.gateway.test_snapshot import goes_on_byte_for_byte
from tests.world import NAMES, World, robot_text

MS = 1_000_000
FILE = """
[[sensor]]
name = "imu"
kind = "heading"
timeout = 0.1

[[sensor]]
name = "lean"
kind = "attitude"
timeout = 0.1

[[sensor]]
name = "nose"
kind = "range"
timeout = 0.2

[[sensor]]
name = "tail"
kind = "range"
timeout = 0.2
"""
TOP_TURN = 1.5  # rad/s
HEADING = SensorKind.HEADING


def with_sensors(text: str) -> str:
    return text + FILE


def sample(name: str, *values: float | None, at: int, sender: str | None = "imu-1") -> SensorSample:
    return SensorSample(name, values, None, at, sender)


def imu(*, timeout: float = 0.1) -> Sensors:
    return Sensors([Sensor(name="imu", kind=HEADING, timeout=timeout)], top_turn=TOP_TURN)


def headings(told: Iterable[tuple[int, float, str]], sensors: Sensors) -> list[Heading | None]:
    """What each of these samples, at ms, reads as in its own cycle."""
    read = []
    for ms, angle, sender in told:
        sensors.receive(sample("imu", angle, at=ms * MS, sender=sender))
        read.append(sensors.read(ms * MS).heading)
    return read


# what is believed


def test_the_first_heading_counts_anew_and_the_next_ones_count() -> None:
    assert headings([(0, 5.0, "a"), (10, 5.01, "a")], imu()) == [Heading(5.0, True, True), Heading(5.01, True, False)]


def test_between_two_samples_it_is_known_but_not_fresh_and_then_silent() -> None:
    sensors = imu()
    headings([(0, 5.0, "a")], sensors)
    assert sensors.read(4 * MS).heading == Heading(5.0, False, False)
    assert sensors.read(100 * MS).heading == Heading(5.0, False, False)
    assert not list(sensors.silent)
    assert sensors.read(101 * MS).heading is None
    assert list(sensors.silent) == ["imu"]


@pytest.mark.parametrize(
    ("second", "anew"),
    [
        ((100, 5.0, "a"), False),
        ((101, 5.0, "a"), True),  # silent for longer than its timeout
        ((10, 5.0, "b"), True),  # another process
        ((10, 5.0 + 0.1 + 0.03, "a"), False),  # 2 * 1.5 rad/s for 10 ms, and the slack
        ((10, 5.0 - 0.1 - 0.031, "a"), True),
        ((10, 5.0 + 2 * pi, "a"), False),  # wrapped
    ],
)
def test_when_a_heading_counts_anew(second: tuple[int, float, str], *, anew: bool) -> None:
    *_, last = headings([(0, 5.0, "a"), second], imu())
    assert last is not None
    assert last.anew is anew


def test_small_jumps_add_up() -> None:
    """0.04 rad too much in each of three samples is a jump in the third, and the count begins again."""
    step = 2 * TOP_TURN * 0.01 + 0.04
    sensors = imu()
    read = headings([(10 * place, step * place, "a") for place in range(6)], sensors)
    assert [one.anew for one in read if one] == [True, False, False, True, False, False]
    assert sensors.describe(0)[0].jumps == 1


@given(st.lists(st.tuples(st.integers(1, 60), st.floats(-20, 20) | st.floats(-0.2, 0.2), st.sampled_from("aaaab"))))
def test_no_sensor_turns_the_pose_faster_than_the_body_can_turn(steps: list[tuple[int, float, str]]) -> None:
    """Whatever it tells: 3 rad/s and 0.1 rad, from any sample to any later one."""
    sensors = imu()
    ms, angle, before = 0, 0.0, 0.0
    excess = 0.0  # of what counted over what the body can turn, at its largest from any sample on
    for after_ms, change, sender in steps:
        ms, angle = ms + after_ms, angle + change
        (read,) = headings([(ms, angle, sender)], sensors)
        assert read is not None
        counted = 0.0 if read.anew else abs((angle - before + pi) % (2 * pi) - pi)
        excess = max(0.0, excess + counted - 3.0 * after_ms * 1e-3)
        assert excess <= 0.1 + 1e-9
        before = angle


def test_ranges_keep_their_places_and_an_attitude_its_unknown_rates() -> None:
    sensors = Sensors(parse(with_sensors(robot_text("moby")), "moby").sensor, top_turn=TOP_TURN)
    sensors.receive(sample("tail", 2.5, at=0))
    sensors.receive(sample("lean", 0.1, -0.2, None, None, 0.3, at=0))
    readings = sensors.read(0)
    assert readings.ranges == (None, 2.5)
    assert readings.attitude == Attitude(0.1, -0.2, None, None, 0.3)
    assert sensors.silent == {"imu": "never heard", "nose": "never heard"}


def test_strangers_and_samples_older_than_the_last_are_left_out() -> None:
    sensors = imu()
    headings([(10, 1.0, "a")], sensors)
    sensors.receive(sample("imu", 0.9, at=9 * MS))
    sensors.receive(sample("nobody", 0.9, at=11 * MS))
    assert sensors.read(11 * MS).heading == Heading(1.0, False, False)


# the robot file


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('[[sensor]]\nname = "gyro"\nkind = "heading"\ntimeout = 0.1\n', "sensor gyro: kind = 'heading': imu already"),
        ('[[sensor]]\nname = "nose"\nkind = "range"\ntimeout = 0.1\n', "sensor.name = 'nose': given twice"),
        ('[[sensor]]\nname = "teleop"\nkind = "range"\ntimeout = 0.1\n', "sensor.name = 'teleop': given twice"),
        ('[[sensor]]\nname = "x"\nkind = "smell"\ntimeout = 0.1\n', 'must be "heading", "attitude" or "range"'),
        ('[[sensor]]\nname = "x"\nkind = "range"\ntimeout = 0.001\n', "must be a number, 0.02 to 2 s"),
    ],
)
def test_what_the_robot_file_may_say(more: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words.replace(".", r"\.")):
        parse(with_sensors(robot_text("moby")) + more, "moby")


# in the core


class Gyro:
    """Tells the true turn of a rate, in rad/s, every so many ms; from where it likes to count."""

    def __init__(self, rate: float, *, zero: float = 3.0, every_ms: int = 12) -> None:
        self.rate, self.zero, self.every_ns = rate, zero, every_ms * MS
        self.first_ns: int | None = None
        self.due_ns = 0

    def __call__(self, now_ns: int) -> list[SensorSample]:
        if now_ns < self.due_ns:
            return []
        self.first_ns = now_ns if self.first_ns is None else self.first_ns
        self.due_ns = now_ns + self.every_ns
        return [sample("imu", self.zero + self.rate * (now_ns - self.first_ns) * 1e-9, at=now_ns)]


@pytest.mark.parametrize("name", NAMES)
def test_the_pose_turns_with_the_gyro_and_drives_with_the_wheels(name: str) -> None:
    """The wheels go straight on; a gyro that says 0.5 rad/s bends the way."""
    world = World(name, edit=with_sensors)
    world.start()
    gyro = Gyro(0.5)
    first = world.run(0.5, Twist(0.3, 0, 0), sensed=gyro).trace
    last = world.run(1.2, Twist(0.3, 0, 0), sensed=gyro).trace
    assert last.pose.theta - first.pose.theta == pytest.approx(0.6, abs=0.01)
    assert last.heading == pytest.approx(3.0 + 0.5 * 1.7, abs=0.01)


def test_a_silent_gyro_leaves_the_turn_to_the_wheels_and_is_told() -> None:
    world = World("omni4", edit=with_sensors)
    world.start()
    gyro = Gyro(0.0)
    world.run(1.0, Twist(0, 0, 0.5), sensed=gyro)
    bridged = world.last.trace.pose.theta
    assert bridged == pytest.approx(0.0, abs=0.01), "it says that the robot does not turn"
    silent = world.run(1.0, Twist(0, 0, 0.5)).trace
    assert silent.pose.theta == pytest.approx(0.5, abs=0.03), "from its last sample on the wheels tell"
    assert silent.heading is None
    assert [code for code in world.codes() if code.startswith("sensor")] == ["sensor_heard", "sensor_silent"]
    gyro.zero = -1.0
    back = world.run(0.2, Twist(0, 0, 0), sensed=gyro).trace
    assert back.heading == -1.0
    assert back.pose.theta == pytest.approx(0.55, abs=0.06), "it counts from where it finds the robot"


def test_a_gyro_that_jumps_moves_no_pose_and_is_told() -> None:
    world = World("omni4", edit=with_sensors)
    world.start()
    gyro = Gyro(0.0)
    world.run(0.3, Twist(0, 0, 0), sensed=gyro)
    gyro.zero = 1.0
    world.run(0.3, Twist(0, 0, 0), sensed=gyro)
    assert world.last.trace.pose.theta == pytest.approx(0.0, abs=1e-3)
    assert "sensor_jump" in world.codes()
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    imu, *_ = status.sensors
    assert (imu.name, imu.kind, imu.values, imu.jumps) == ("imu", "heading", (1.0,), 1)


def all_of_them(now_ns: int) -> list[SensorSample]:
    if now_ns % (20 * MS):
        return []
    angle = now_ns * 1e-10
    return [
        sample("imu", angle, at=now_ns),
        sample("lean", 0.1, angle % 0.1, None, 0.2, None, at=now_ns),
        sample("nose", angle % 2.0, at=now_ns),
    ]


@pytest.mark.parametrize("name", NAMES)
def test_it_is_in_the_snapshot_and_restored_at_any_cycle(name: str) -> None:
    world = World(name, edit=with_sensors)
    world.start()
    world.run(0.4, Twist(0.2, 0, 0.3), sensed=all_of_them)
    world.run(0.2, Twist(0.2, 0, 0.3))
    assert goes_on_byte_for_byte(world.records, world.config, every=3) > 70


def test_without_the_samples_it_is_another_drive() -> None:
    world = World("omni4", edit=with_sensors)
    world.start()
    world.run(0.5, Twist(0.2, 0, 0.3), sensed=all_of_them)

    def replayed(*, keep: bool) -> list[str]:
        engine = Engine(world.config)
        taken: list[Inputs] = [one if keep else one._replace(samples=()) for one, _ in world.records]
        return [repr(engine.step(inputs)) for inputs in taken]

    recorded = [repr(outputs) for _, outputs in world.records]
    assert replayed(keep=True) == recorded
    assert replayed(keep=False) != recorded


# simulated, as `run --simulate` publishes them


class Told:
    """A client that keeps what it is given."""

    def __init__(self) -> None:
        self.samples: list[tuple[str, dict[str, float | None]]] = []

    def sense(self, sensor: str, **values: float | None) -> None:
        self.samples.append((sensor, values))


def test_a_simulated_robot_tells_what_sensors_by_zenoh_would_with_every_odometry() -> None:
    """A robot whose wheels do not go apart has nothing that a range would tell."""
    world, told, truths = World("moby", edit=with_sensors), Told(), []
    robot = world.bus.robot
    sense = together(lambda now_ns, _: truths.append(now_ns), sensing(robot, world.config, cast(Client, told)))
    for _ in range(250):
        outputs = world.cycle()
        sense(world.now_ns, outputs)
    assert len(truths) == 250
    assert {name for name, _ in told.samples} == {"imu", "lean"}
    heard = [values["heading"] for name, values in told.samples if name == "imu"]
    assert len(heard) == 50
    assert heard == pytest.approx([0.0] * 50, abs=5e-3)
    assert set(told.samples[0][1]) <= {"heading", "roll", "pitch", "roll_rate", "pitch_rate", "yaw_rate"}
