"""Every fault that a scenario can name, by what it does to the world; how the core takes it is tested elsewhere."""

from collections.abc import Callable, Iterable
from itertools import pairwise
from math import hypot, pi
from struct import unpack
from typing import Any

import pytest

from drivers.contract import CanFrame
from gateway.types import BusEventKind
from replay.drive.faults import RULES, FaultKind, Target
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from replay.sim.plants.rigid_body import GRAVITY

AT = 2.5  # s; the robot drives by then
DRIVEN: tuple[dict[str, Any], ...] = (
    {"t": 0.3, "command": {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}},
    {"t": 1.0, "command": {"source": "teleop", "vx": 0.5, "vy": 0.0, "wz": 0.0}},
)
IDLE: tuple[dict[str, Any], ...] = ()
TICKS = 8192 / (2.0 * pi)
FRONT_LEFT, RIGHT = 0, 1


def drive(
    robot: str,
    *faults: dict[str, Any],
    before: Iterable[dict[str, Any]] = DRIVEN,
    seconds: float = 3.5,
    plant: str = "simple",
) -> list[Moment]:
    """A drive in which these faults begin at AT, unless they say `t`."""
    moments: list[Moment] = []
    at = [*before, *({"t": fault.pop("t", AT), "fault": fault} for fault in map(dict, faults))]
    scenario = Scenario.model_validate({"robot": robot, "seconds": seconds, "at": at, "plant": plant})
    run_scenario(scenario, watch=moments.append)
    return moments


def between(moments: Iterable[Moment], start: float, end: float) -> list[Moment]:
    return [moment for moment in moments if start <= moment.t < end]


def frames(moments: Iterable[Moment], identifier: int) -> list[CanFrame]:
    return [frame for moment in moments for frame in moment.inputs.frames if frame.id == identifier]


def heard(moments: Iterable[Moment], start: float, end: float, identifier: int = 0x201) -> int:
    return len(frames(between(moments, start, end), identifier))


def at(moments: list[Moment], t: float) -> Moment:
    return next(moment for moment in moments if moment.t >= t - 1e-9)


def dji_angle(frame: CanFrame) -> int:
    return int(unpack(">H", frame.data[:2])[0])


def dji_current(frame: CanFrame) -> int:
    return int(unpack(">h", frame.data[4:6])[0])


def turns(frame: CanFrame) -> float:
    return float(unpack("<ff", frame.data)[0])


# -- power and cable --------------------------------------------------------------------------------------------------


def power_off() -> None:
    moments = drive("omni4", {"kind": "power_off", "motor": "front_left", "seconds": 0.5})
    dark = between(moments, AT + 0.01, AT + 0.5)
    assert all(moment.truth.joint_torques[FRONT_LEFT] == 0.0 for moment in dark)
    assert not frames(dark, 0x201)
    assert frames(dark, 0x202)
    assert heard(moments, AT + 0.51, AT + 1.0) > 400, "it ends by itself"


def power_on() -> None:
    off = {"kind": "power_off", "motor": "front_left"}
    moments = drive("omni4", off, {"t": 3.0, "kind": "power_on", "motor": "front_left"})
    assert heard(moments, AT + 0.01, 3.0) == 0
    assert heard(moments, 3.01, 3.5) > 400


def power_cycle() -> None:
    moments = drive("moby", {"kind": "power_cycle", "motor": "right"})
    right = 2 << 5 | 0x09
    before, after = (frames(between(moments, *window), right) for window in ((2.4, AT), (AT + 0.01, 2.55)))
    assert abs(turns(before[-1])) > 10.0
    assert abs(turns(after[0])) < 2.0, "an incremental encoder forgets where it was"
    longer = drive("moby", {"kind": "power_cycle", "motor": "right", "seconds": 0.3})
    assert heard(longer, AT + 0.01, AT + 0.3, right) == 0
    assert heard(longer, AT + 0.31, AT + 0.61, right) > 70


def cable_out() -> None:
    moments = drive("omni4", {"kind": "cable_out", "motor": "front_left", "seconds": 0.2})
    assert heard(moments, AT + 0.01, AT + 0.2) == 0
    assert heard(moments, AT + 0.21, AT + 0.4) > 150
    torques = {moment.truth.joint_torques[FRONT_LEFT] for moment in between(moments, AT + 0.01, AT + 0.2)}
    assert len(torques) == 1, "deaf, it goes on with the last current"
    assert torques != {0.0}


def cable_in() -> None:
    moments = drive("omni4", {"kind": "cable_out"}, {"t": 3.0, "kind": "cable_in", "motor": "rear_left"})
    assert heard(moments, 3.01, 3.5, 0x202) > 400
    assert heard(moments, 3.01, 3.5, 0x201) == 0


# -- encoders ---------------------------------------------------------------------------------------------------------


def encoder_frozen() -> None:
    moments = drive("omni4", {"kind": "encoder_frozen", "motor": "front_left", "seconds": 0.1})
    stuck = frames(between(moments, AT + 0.01, AT + 0.1), 0x201)
    assert len({dji_angle(frame) for frame in stuck}) == 1
    assert abs(at(moments, AT + 0.05).truth.joint_rates[FRONT_LEFT]) > 1.0
    assert len({dji_angle(frame) for frame in frames(between(moments, AT + 0.11, AT + 0.15), 0x201)}) > 10


def encoder_jump() -> None:
    jumped = drive("moby", {"kind": "encoder_jump", "motor": "right", "value": 0.5})
    plain = drive("moby")
    right = 2 << 5 | 0x09
    told, right_reading = (frames(between(one, AT + 0.012, AT + 0.02), right)[0] for one in (jumped, plain))
    assert turns(told) - turns(right_reading) == pytest.approx(-0.5 * 50.0 / (2.0 * pi), abs=0.3), "mounted mirrored"


# -- torque -----------------------------------------------------------------------------------------------------------


def torque_lost() -> None:
    moments = drive("omni4", {"kind": "torque_lost", "motor": "front_left"})
    window = between(moments, AT + 0.01, AT + 0.1)
    assert all(moment.truth.joint_torques[FRONT_LEFT] == 0.0 for moment in window)
    assert any(dji_current(frame) != 0 for frame in frames(window, 0x201)), "its controller does not know"


def torque_inverted() -> None:
    moments = drive("omni4", {"kind": "torque_inverted", "motor": "front_left"})
    window = between(moments, AT + 0.02, AT + 0.06)
    told = dji_current(frames(window, 0x201)[-1])
    assert abs(told) > 100
    assert window[-1].truth.joint_torques[FRONT_LEFT] * told < 0.0


def brake_weak() -> None:
    def braked(*faults: dict[str, Any]) -> list[Moment]:
        stop = {"t": AT + 0.01, "request": "estop"}
        return drive("omni4", *faults, before=(*DRIVEN, stop))

    weak = braked(*({"kind": "brake_weak", "value": 0.1} for _ in range(1)))
    sound = braked()
    first = AT + 0.03
    assert at(weak, first).speed > at(sound, first).speed
    for moment in between(weak, AT + 0.02, AT + 0.1):
        for torque, rate in zip(moment.truth.joint_torques, moment.truth.joint_rates, strict=True):
            assert torque * rate >= 0.0 or abs(torque) <= 0.1 * 4.5 + 1e-9


# -- the bus ----------------------------------------------------------------------------------------------------------


def id_twin() -> None:
    moments = drive("moby", {"kind": "id_twin", "motor": "right", "value": 1.0, "seconds": 0.4}, before=IDLE)
    right = 2 << 5 | 0x09
    plain, doubled, after = (heard(moments, *window, right) for window in ((2.1, 2.5), (2.5, 2.9), (2.91, 3.31)))
    assert doubled == pytest.approx(2 * plain, abs=4)
    assert after == pytest.approx(plain, abs=2)
    readings = {round(turns(frame), 3) for frame in frames(between(moments, 2.6, 2.8), right)}
    assert len(readings) == 2


def bus_down() -> None:
    moments = drive("omni4", {"kind": "bus_down", "seconds": 0.2})
    assert heard(moments, AT + 0.01, AT + 0.2) == 0
    assert heard(moments, AT + 0.21, AT + 0.4) > 150
    kinds = [event.kind for moment in moments for event in moment.inputs.bus_events]
    assert [kind for kind in kinds if kind is not BusEventKind.TX_DROPPED] == [BusEventKind.DOWN, BusEventKind.UP]


def bus_up() -> None:
    moments = drive("omni4", {"kind": "bus_down"}, {"t": 3.0, "kind": "bus_up", "bus": "can0"})
    assert heard(moments, AT + 0.01, 3.0) == 0
    assert heard(moments, 3.01, 3.5) > 400


def frames_lost() -> None:
    moments = drive("omni4", {"kind": "frames_lost", "value": 0.5, "seconds": 0.4})
    assert heard(moments, AT, AT + 0.4) == pytest.approx(200, abs=60)
    assert heard(moments, AT + 0.41, AT + 0.81) == pytest.approx(400, abs=5)


def frames_delayed() -> None:
    moments = drive("omni4", {"kind": "frames_delayed", "value": 0.05}, before=IDLE)
    assert heard(moments, AT + 0.004, AT + 0.048) == 0
    assert heard(moments, AT + 0.06, AT + 0.16) == pytest.approx(100, abs=3)
    for moment in moments:
        stamps = [frame.received_ns or 0 for frame in moment.inputs.frames]
        assert stamps == sorted(stamps)
        assert not stamps or stamps[-1] <= moment.inputs.now_ns
    # Both ways: the first current reaches the motors later too.
    delayed, plain = (
        next(moment.t for moment in one if moment.truth.joint_torques[0] != 0.0)
        for one in (drive("omni4", {"t": 0.0, "kind": "frames_delayed", "value": 0.02}), drive("omni4"))
    )
    assert delayed - plain >= 0.02


# -- the world --------------------------------------------------------------------------------------------------------


def frames_doubled() -> None:
    plain = heard(drive("omni4"), AT, AT + 0.4)
    moments = drive("omni4", {"kind": "frames_doubled", "value": 1.0, "seconds": 0.4})
    assert heard(moments, AT, AT + 0.4) == pytest.approx(2 * plain, abs=10)
    assert heard(moments, AT + 0.41, AT + 0.81) == pytest.approx(plain, abs=5)


def push() -> None:
    moments = drive("omni4", {"kind": "push", "value": 100.0, "seconds": 0.2}, before=IDLE)
    assert at(moments, AT).speed == 0.0
    end = at(moments, AT + 0.2).truth.twist
    assert 0.3 < end.vx < 100.0 * 0.2 / 25.0
    assert at(moments, 3.4).truth.twist.vx < end.vx, "nobody pushes any more"


def impact() -> None:
    """Pushed along at 0.5 m/s: hit at the caster's joint the chassis turns left, and comes back under the platform.

    That was turned too, by 0.15 rad: nothing holds a heading.
    """
    hit = {"kind": "impact", "value": 3000.0, "seconds": 0.025}
    moments = drive("moby", hit, plant="dynamics", seconds=5.0)
    before, after, end = (at(moments, t).truth for t in (AT - 0.01, AT + 0.052, 4.9))
    assert abs(before.chassis_angle) < 1e-3
    assert after.chassis_angle > 0.1
    assert after.joint_angles[2] < -0.05
    assert end.joint_angles[2] == pytest.approx(0.0, abs=1e-3)


def slope() -> None:
    moments = drive("omni4", {"kind": "slope", "value": 0.1, "seconds": 0.5}, before=IDLE)
    end = at(moments, AT + 0.5).truth.twist
    assert -0.5 * GRAVITY * 0.1 < end.vx < -0.2
    assert abs(at(moments, 3.4).truth.twist.vx) < abs(end.vx)


def friction() -> None:
    ice = {"t": 0.0, "kind": "friction", "value": 0.02}
    moments = drive("omni4", ice)
    steepest = max(
        hypot(*(b - a for a, b in zip(one.truth.twist[:2], two.truth.twist[:2], strict=True))) / 0.004
        for one, two in pairwise(moments)
    )
    assert steepest <= 0.02 * GRAVITY * 1.01
    rim = abs(at(moments, 2.0).truth.joint_rates[FRONT_LEFT]) * 0.0762
    assert rim > abs(at(moments, 2.0).truth.twist.vx), "the wheels spin"


def mass() -> None:
    moments = drive("omni4", {"kind": "mass", "value": 75.0})
    assert at(moments, AT + 0.004).speed < 0.5 * at(moments, AT - 0.004).speed


# -- sensors on a bus -------------------------------------------------------------------------------------------------


WIRE = 0x120


def lengths(moments: Iterable[Moment], start: float, end: float) -> list[float]:
    return [1e-6 * unpack("<I", frame.data[:4])[0] for frame in frames(between(moments, start, end), WIRE)]


def sensor_silent() -> None:
    moments = drive("odd", {"kind": "sensor_silent", "sensor": "wire", "seconds": 0.5})
    assert len(lengths(moments, AT - 0.5, AT)) == pytest.approx(50, abs=1)
    assert not lengths(moments, AT + 0.01, AT + 0.5)
    assert heard(moments, AT + 0.01, AT + 0.5, 0x110) > 100, "the IMU is heard"
    assert len(lengths(moments, AT + 0.51, AT + 1.0)) == pytest.approx(49, abs=1)


def sensor_frozen() -> None:
    moments = drive("odd", {"kind": "sensor_frozen", "sensor": "wire", "seconds": 0.5})
    frozen = frames(between(moments, AT + 0.01, AT + 0.5), WIRE)
    assert len(frozen) == pytest.approx(49, abs=1)
    assert len({frame.data for frame in frozen}) == 1
    assert len({frame.data for frame in frames(between(moments, AT + 0.51, AT + 1.0), WIRE)}) > 40


def sensor_stuck() -> None:
    moments = drive("odd", {"kind": "sensor_stuck", "seconds": 0.5})
    stuck = frames(between(moments, AT + 0.02, AT + 0.5), WIRE)
    assert len({frame.data[:4] for frame in stuck}) == 1
    assert len({frame.data[4] for frame in stuck}) == 16, "it counts on"
    leaning = frames(between(moments, AT + 0.02, AT + 0.5), 0x110)
    assert len({frame.data[:6] for frame in leaning}) == 1


def sensor_jump() -> None:
    moments = drive("odd", {"kind": "sensor_jump", "sensor": "wire", "value": 0.1, "seconds": 0.5})
    assert lengths(moments, AT + 0.02, AT + 0.5) == pytest.approx([0.5] * 48, abs=2e-3)
    assert lengths(moments, AT + 0.52, AT + 1.0) == pytest.approx([0.4] * 48, abs=2e-3)


# -- the loop, and the end of it all ----------------------------------------------------------------------------------


def loop_pause() -> None:
    moments = drive("omni4", {"kind": "loop_pause", "seconds": 0.2})
    assert not between(moments, AT + 0.001, AT + 0.2)
    first = at(moments, AT + 0.001)
    assert first.t == pytest.approx(AT + 0.2)
    assert len(first.inputs.frames) == pytest.approx(4 * 200, abs=20), "they waited"
    assert first.inputs.overruns == 50
    assert len(first.inputs.commands) == 1, "of what was commanded meanwhile only the newest is left"
    assert [moment.inputs.cycle for moment in moments] == list(range(len(moments)))


def clear() -> None:
    moments = drive(
        "omni4",
        {"kind": "power_off", "motor": "front_left"},
        {"kind": "cable_out", "motor": "rear_left"},
        {"kind": "encoder_frozen", "motor": "rear_right"},
        {"kind": "torque_lost", "motor": "rear_right"},
        {"kind": "friction", "value": 0.0},
        {"kind": "frames_lost", "value": 1.0},
        {"kind": "frames_delayed", "value": 0.5},
        {"kind": "bus_down"},
        {"kind": "slope", "value": 0.3},
        {"kind": "mass", "value": 500.0},
        {"t": 3.0, "kind": "clear"},
        before=IDLE,
        seconds=4.0,
    )
    assert all(heard(moments, AT + 0.01, 3.0, identifier) == 0 for identifier in range(0x201, 0x205))
    assert all(heard(moments, 3.01, 3.51, identifier) > 480 for identifier in range(0x201, 0x205))
    assert abs(at(moments, 3.9).truth.twist.vx) < abs(at(moments, 3.0).truth.twist.vx), "level again"


EFFECTS: dict[FaultKind, Callable[[], None]] = {
    FaultKind(effect.__name__): effect
    for effect in (
        power_off,
        power_on,
        power_cycle,
        cable_out,
        cable_in,
        encoder_frozen,
        encoder_jump,
        torque_lost,
        torque_inverted,
        brake_weak,
        id_twin,
        bus_down,
        bus_up,
        frames_lost,
        frames_delayed,
        frames_doubled,
        push,
        impact,
        slope,
        friction,
        mass,
        sensor_silent,
        sensor_frozen,
        sensor_stuck,
        sensor_jump,
        loop_pause,
        clear,
    )
}


@pytest.mark.parametrize("kind", FaultKind, ids=lambda kind: kind.value)
def test_effect(kind: FaultKind) -> None:
    EFFECTS[kind]()


def test_every_kind_has_its_row() -> None:
    assert set(RULES) == set(FaultKind) == set(EFFECTS)
    assert all(rule.end is not None or not rule.timed or rule.target is Target.LOOP for rule in RULES.values())


def test_clear_of_one_motor_leaves_the_others_broken() -> None:
    moments = drive("omni4", {"kind": "cable_out"}, {"t": 3.0, "kind": "clear", "motor": "front_left"}, before=IDLE)
    assert heard(moments, 3.01, 3.5, 0x201) > 400
    assert heard(moments, 3.01, 3.5, 0x202) == 0


def test_clear_mends_sensors() -> None:
    broken = [{"kind": kind, "sensor": "wire"} for kind in ("sensor_silent", "sensor_frozen", "sensor_stuck")]
    jump = {"kind": "sensor_jump", "sensor": "wire", "value": 0.1}
    moments = drive("odd", jump, *broken, {"t": 3.0, "kind": "clear"}, before=IDLE)
    assert not lengths(moments, AT + 0.01, 3.0)
    told = lengths(moments, 3.02, 3.5)
    assert told == pytest.approx([0.4] * len(told), abs=1e-3)
    assert len(set(told)) > 40


def test_clear_ends_an_impact() -> None:
    hit = {"kind": "impact", "value": 200.0, "seconds": 10.0}
    moments = drive("moby", hit, {"t": 2.6, "kind": "clear"}, before=IDLE, plant="dynamics", seconds=4.0)
    angles = [at(moments, t).truth.chassis_angle for t in (2.6, 3.0, 3.4, 3.8)]
    first, second, third = (after - before for before, after in pairwise(angles))
    assert first > second > third > 0.0, "it slows down, as nobody pushes any more"


def test_an_absolute_encoder_knows_its_angle_after_a_power_cycle() -> None:
    start = {"start": {"joint": {"platform": -1.2, "left": 0.7}}}
    scenario = Scenario.model_validate(
        {"robot": "moby", "seconds": 1.0, "at": [{"t": 0.5, "fault": {"kind": "power_cycle"}}]} | start
    )
    moments: list[Moment] = []
    run_scenario(scenario, watch=moments.append)
    assert moments[0].truth.joint_angles == (0.7, 0.0, -1.2)
    for window in ((0.1, 0.5), (0.51, 1.0)):
        platform, left = (frames(between(moments, *window), node << 5 | 0x09)[-1] for node in (3, 1))
        assert turns(platform) == pytest.approx(-1.2 * 50.0 / (2.0 * pi))
        assert turns(left) == 0.0, "an incremental one counts from where it was switched on"
