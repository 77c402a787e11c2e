"""Sensors on a bus, through the whole core: what becomes of their frames, and how each way to fail shows."""

from collections.abc import Callable

import pytest

from gateway.config import ConfigError, parse
from gateway.core.assembly import build
from gateway.core.engine import Engine
from gateway.core.examination import examine
from gateway.core.frame_words import FrameWords
from gateway.types import Attitude, SensorStatus, Twist
from replay.sim.sensors.sender import Sender
from tests.gateway.test_snapshot import goes_on_byte_for_byte
from tests.world import World, robot_text

TURNING = Twist(0.2, 0.0, 0.4)
IMU = """
[[sensor]]
name = "imu"
kind = "attitude"
timeout = 0.03
bus = "can0"
driver = "imu"
id = 0x110
rate = 250.0
"""

AGAIN = IMU.replace('"imu"', '"x"', 1)
NEXT = AGAIN.replace('"attitude"', '"heading"').replace("0x110", "0x111")


def odd() -> World:
    world = World("odd")
    world.start()
    world.run(0.5, TURNING)
    return world


def status(world: World, name: str) -> SensorStatus:
    told = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    return next(sensor for sensor in told.sensors if sensor.name == name)


def lean(world: World) -> Attitude | None:
    return world.last.trace.attitude


def twin(world: World, name: str) -> Sender:
    return world.bus.robot.sensors[name]


def test_what_they_tell_is_measured_within_a_cycle_or_two() -> None:
    world = odd()
    truth, trace = world.bus.robot.truth, world.last.trace
    assert trace.attitude is not None
    assert trace.attitude.yaw_rate == pytest.approx(truth.twist.wz, abs=0.03)
    assert trace.attitude[:4] == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=0.02)
    assert trace.heading == pytest.approx(truth.pose.theta, abs=0.01)
    assert trace.pose.theta == pytest.approx(truth.pose.theta, abs=0.01)
    assert trace.ranges == pytest.approx((0.4,), abs=1e-3)
    assert world.engine._measured.attitude == trace.attitude
    assert twin(world, "imu") is twin(world, "gyro"), "one IMU tells both"


@pytest.mark.parametrize(
    ("begin", "end", "why"),
    [
        (Sender.unplug, Sender.plug, "silent"),
        (lambda one: one.hang(True), lambda one: one.hang(False), "its counter stands still"),
    ],
)
def test_one_that_fails_is_none_after_its_timeout_named_and_heard_again(
    begin: Callable[[Sender], None], end: Callable[[Sender], None], why: str
) -> None:
    world = odd()
    begin(twin(world, "imu"))
    world.run(0.02, TURNING)
    assert lean(world) is not None, "for as long as its last sample is believed"
    world.events.clear()
    world.run(0.2, TURNING)
    assert lean(world) is None
    assert world.last.trace.heading is None
    assert world.last.trace.ranges != (None,)
    told = [event.text for event in world.events if event.code == "sensor_silent"]
    assert sorted(told) == [f"gyro: {why}", f"imu: {why}"]
    assert (status(world, "imu").values, status(world, "imu").reason) == (None, why)
    end(twin(world, "imu"))
    world.run(0.2, TURNING)
    assert lean(world) is not None
    assert [event.text for event in world.events if event.code == "sensor_heard"] == ["imu: heard", "gyro: heard"]
    assert status(world, "imu").reason is None


def test_an_attitude_that_jumps_is_believed_again_once_it_has_stood_for_its_timeout() -> None:
    world = odd()
    twin(world, "imu").shift("attitude", 0.4)
    seen = [world.cycle().trace.attitude for _ in range(25)]
    believed = [place for place, one in enumerate(seen) if one is not None]
    assert 7 <= believed[0] <= 10
    assert believed == list(range(believed[0], 25))
    assert [one.pitch for one in seen if one] == pytest.approx([0.4] * len(believed), abs=0.01)
    assert "sensor_jump" in world.codes()
    world.run(0.1, TURNING)
    assert status(world, "imu").jumps == 1


def test_a_wire_out_of_its_range_says_so_itself() -> None:
    world = odd()
    twin(world, "wire").shift("range", -1.0)
    world.run(0.3, TURNING)
    assert world.last.trace.ranges == (None,)
    assert status(world, "wire").reason == "out of its range"


def test_what_was_wrong_before_is_not_why_it_is_silent_now() -> None:
    world = odd()
    twin(world, "imu").hang(True)
    world.run(0.1, TURNING)
    twin(world, "imu").hang(False)
    world.run(0.1, TURNING)
    twin(world, "imu").unplug()
    world.run(0.2, TURNING)
    assert status(world, "imu").reason == "silent"


def test_it_is_in_the_snapshot_and_replayed_byte_for_byte() -> None:
    world = odd()
    twin(world, "imu").unplug()
    world.run(0.1, TURNING)
    twin(world, "imu").plug()
    world.run(0.1, TURNING)
    assert goes_on_byte_for_byte(world.records, world.config, every=3) > 80
    engine = Engine(world.config)
    assert [repr(engine.step(inputs)) for inputs, _ in world.records] == [repr(one) for _, one in world.records]


def test_their_frames_in_words() -> None:
    world = odd()
    words = FrameWords(world.config)
    told = [words.of(frame) for frame in world.records[-1][0].frames]
    assert any(line.startswith("imu Angles roll=") and " yaw=" in line for line in told)
    assert any(line.startswith("imu Rates roll_rate=") for line in told)
    every = [words.of(frame) for inputs, _ in world.records[-10:] for frame in inputs.frames]
    assert any(line.startswith("wire Length length=0.4") for line in every)


def test_buses_let_their_frames_pass_and_count_them_once() -> None:
    robot = build(parse(robot_text("odd"), "odd"))
    assert {0x110, 0x111, 0x120} <= {wanted.id for wanted in robot.receive_filters("can0")}
    names = [item.name for item in robot.traffic("can0", loop_rate_hz=250.0)]
    assert [name for name in names if "Angles" in name or "Rates" in name] == ["gyro Angles", "gyro Rates"]
    assert robot.receive_filters("can1") == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("id = 0x110", "id = 0x201", r"bus can0: .*motor front_left \(0x201\) and sensor imu \(0x201\) share CAN ids"),
        ("id = 0x110", "id = 0x1FF", r"sensor imu \(0x200\) share CAN ids"),
        ("id = 0x110", "id = 0x7FF", r"sensor imu: id = 2047: must be 0 to 0x7FE"),
        ('bus = "can0"', 'bus = "can7"', r"sensor imu: bus = 'can7': no such \[\[bus\]\]"),
        ('driver = "imu"', 'driver = "nose"', r"sensor imu: driver = 'nose': no such driver; there is draw_wire, imu"),
        ('kind = "attitude"', 'kind = "range"', r"sensor imu: kind = 'range': driver imu tells attitude, heading"),
        ("rate = 250.0\n", "", r"give all of bus, driver, id and rate, or none of them"),
        ("rate = 250.0\n", "rate = 50.0\n", r"timeout = 0\.03: must be at least 0\.06: 3 periods of rate = 50 Hz"),
        ("rate = 250.0\n", f"rate = 250.0\n{NEXT}", r"sensor imu \(0x111\) and sensor x \(0x111\) share CAN ids"),
        ("rate = 250.0\n", f"rate = 250.0\n{AGAIN}", r"sensor x: kind = 'attitude': imu already tells it"),
    ],
)
def test_what_the_robot_file_may_not_say(old: str, new: str, words: str) -> None:
    assert IMU.count(old) == 1
    text = robot_text("omni4") + IMU.replace(old, new)
    with pytest.raises(ConfigError, match=words):
        build(parse(text, "omni4"))


def test_check_tells_how_each_is_heard() -> None:
    by_zenoh = '[[sensor]]\nname = "nose"\nkind = "range"\ntimeout = 0.2\n\n[commands]'
    told = examine(parse(robot_text("odd").replace("[commands]", by_zenoh, 1), "odd"), "odd").sensors
    assert told[0] == ("wire", "range", "can0, draw_wire 0x120, 100 Hz")
    assert told[-1] == ("nose", "range", "Zenoh")


def test_a_width_sensor_that_is_not_there_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"robot.width_sensor = 1: no such .* of kind 'range'; from 0 on there is wire"
    ):
        parse(robot_text("odd").replace("width_sensor = 0", "width_sensor = 1"), "odd")


def test_two_draw_wires_need_two_ids() -> None:
    wire = IMU.replace('"imu"', '"a"', 1).replace('"imu"', '"draw_wire"').replace('"attitude"', '"range"')
    both = robot_text("omni4") + wire + wire.replace('"a"', '"b"')
    with pytest.raises(ConfigError, match="sensor b: id = 272: already the id of sensor a"):
        build(parse(both, "omni4"))
