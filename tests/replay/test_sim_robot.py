"""The whole simulated robot behind its bus: raw frames in, true motion out."""

from math import pi
from struct import pack, unpack

import pytest

from drivers import DRIVERS
from drivers.contract import CanFrame
from gateway.config import RobotConfig
from replay.sim.bus import SimulatedBus
from replay.sim.network_device import HEARD
from replay.sim.robot import CONTROLLERS
from tests.replay.test_sim_bus import MILLISECOND, MOBY, OMNI, START, drive, odrive, stamps


def test_every_driver_has_a_simulated_controller_in_process_and_on_a_real_interface() -> None:
    assert set(DRIVERS) == set(CONTROLLERS) == set(HEARD)


def arm_frames() -> list[CanFrame]:
    frames = []
    for node in (1, 2, 3):
        frames += [
            CanFrame("can0", node << 5 | 0x0B, pack("<II", 2, 2)),
            CanFrame("can0", node << 5 | 0x0F, pack("<ff", 200.0, 40.0)),
            CanFrame("can0", node << 5 | 0x07, pack("<I", 8)),
        ]
    return frames


def velocity_frames(*turns_per_second: float) -> list[CanFrame]:
    return [
        CanFrame("can0", node << 5 | 0x0D, pack("<ff", turns, 0.0)) for node, turns in enumerate(turns_per_second, 1)
    ]


def test_moby_drives_straight_and_its_encoders_tell() -> None:
    bus = SimulatedBus(MOBY)
    bus.receive(START)
    bus.send(arm_frames(), START)
    # 0.5 m/s are 5 rad/s at the wheel, 250 rad/s at the shaft; the right motor is mounted mirrored.
    shaft = 250.0 / (2.0 * pi)
    received, events = drive(bus, 500, velocity_frames(shaft, -shaft, 0.0), start_ns=START + 4 * MILLISECOND)
    truth = bus.robot.truth
    assert events == []
    assert truth.twist == pytest.approx((0.5, 0.0, 0.0), abs=1e-3)
    assert truth.joint_angles[0] == pytest.approx(truth.pose.x / 0.1)
    for node, sign in ((1, 1), (2, -1)):
        turns, speed = unpack("<ff", [frame.data for frame in received if frame.id == node << 5 | 0x09][-1])
        assert speed == pytest.approx(shaft * sign, rel=2e-3)
        age = (truth.joint_angles[0] * 50.0 / (2.0 * pi) * sign - turns) / speed
        assert 0.0 <= age < 0.006


def test_moby_platform_turns_on_the_spot_of_the_chassis() -> None:
    bus = SimulatedBus(MOBY)
    bus.receive(START)
    bus.send(arm_frames(), START)
    shaft = 0.5 * 50.0 / (2.0 * pi)
    drive(bus, 500, velocity_frames(0.0, 0.0, shaft), start_ns=START + 4 * MILLISECOND)
    truth = bus.robot.truth
    assert truth.twist == pytest.approx((0.0, 0.0, 0.5), abs=2e-3)
    assert truth.chassis_angle == pytest.approx(0.0, abs=2e-3)


def test_output_angle_starts_at_the_configured_zero() -> None:
    document = MOBY.model_dump()
    document["motor"][2]["zero"] = 0.75
    bus = SimulatedBus(RobotConfig.model_validate(document))
    frames, _ = drive(bus, 4)
    assert bus.robot.truth.joint_angles[2] == 0.75
    reading = [frame.data for frame in frames if frame.id == 3 << 5 | 0x09][-1]
    assert reading == pack("<ff", 0.75 * 50.0 / (2.0 * pi), 0.0)
    assert bus.robot.truth.chassis_angle == 0.0


def test_omni_rotates_and_strafes_under_current() -> None:
    spin = SimulatedBus(OMNI)
    drive(spin, 100, [CanFrame("can0", 0x200, pack(">4h", 400, 400, 400, 400))])
    assert spin.robot.truth.twist.wz > 0.2
    strafe = SimulatedBus(OMNI)
    drive(strafe, 100, [CanFrame("can0", 0x200, pack(">4h", 400, -400, -400, 400))])
    assert strafe.robot.truth.twist.vy > 0.02
    assert strafe.robot.truth.twist.vx == pytest.approx(0.0, abs=1e-9)


def test_several_buses_are_separate_and_merged_by_arrival() -> None:
    document = OMNI.model_dump()
    document["bus"].append(document["bus"][0] | {"name": "can1", "channel": "can1", "bitrate": 500_000})
    for motor in document["motor"][2:]:
        motor["bus"] = "can1"
    bus = SimulatedBus(RobotConfig.model_validate(document))
    received, _ = drive(bus, 50, [CanFrame("can1", 0x200, pack(">4h", 400, 400, 400, 400))])
    assert {(frame.bus, frame.id) for frame in received} == {
        ("can0", 0x201),
        ("can0", 0x202),
        ("can1", 0x203),
        ("can1", 0x204),
    }
    assert stamps(received) == sorted(stamps(received))
    assert bus.load("can1") == pytest.approx(2.25 * 0.27, rel=0.02)
    assert bus.load("can0") == pytest.approx(2.0 * 0.135, rel=0.02)


def test_robot_must_be_started() -> None:
    with pytest.raises(RuntimeError, match="not been started"):
        SimulatedBus(OMNI).robot.advance(0)


def test_unknown_controller_is_named() -> None:
    document = OMNI.model_dump()
    document["motor"][1]["driver"] = "steam"
    with pytest.raises(ValueError, match="motor rear_left: driver 'steam'"):
        SimulatedBus(RobotConfig.model_validate(document))


def test_odrive_watchdog_stops_the_robot_when_the_host_dies() -> None:
    bus = SimulatedBus(MOBY)
    bus.receive(START)
    bus.send([CanFrame("can0", n << 5 | 0x04, pack("<BHBf", 1, 189, 0, 0.1)) for n in (1, 2, 3)], START)
    bus.send([CanFrame("can0", n << 5 | 0x04, pack("<BHB?", 1, 188, 0, True)) for n in (1, 2, 3)], START)
    bus.send(arm_frames(), START)
    shaft = 250.0 / (2.0 * pi)
    drive(bus, 300, velocity_frames(shaft, -shaft, 0.0), start_ns=START + 4 * MILLISECOND)
    speed = bus.robot.truth.twist.vx
    last_sent_ns = START + 1200 * MILLISECOND
    bus.receive(last_sent_ns + 100 * MILLISECOND)
    assert odrive(bus, "left").axis.errors == 0
    bus.receive(last_sent_ns + 102 * MILLISECOND)
    assert {odrive(bus, name).axis.errors for name in bus.robot.devices} == {0x01000000}
    bus.receive(START + 40_000 * MILLISECOND)
    assert speed == pytest.approx(0.5, abs=1e-3)
    assert bus.robot.truth.twist.vx == pytest.approx(0.0, abs=1e-3)
