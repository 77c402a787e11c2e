"""omni4 with three, two and one of its motors, through the closed loop: what it still does, and the way back."""

import math
from collections.abc import Sequence
from itertools import groupby, pairwise, permutations

import pytest

from gateway.config import RobotConfig, parse
from gateway.core.engine import Engine
from gateway.core.health import Fault, Health, HealthMonitor
from gateway.core.limp_watch import LimpWatch
from gateway.kinematics.reachable import Reachable
from gateway.types import Mode
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from tests.world import robot_text

TEXT = robot_text("omni4", rate_hz=125.0)
OMNI4 = parse(TEXT, "omni4")
LIMPING = parse(TEXT.replace("[limits]", '[degraded]\nmotor_lost = "limp"\nspeed = 0.3\n\n[limits]', 1), "omni4")
MOTORS = ("front_left", "rear_left", "rear_right", "front_right")
PERIOD = 0.008  # s
Entry = dict[str, object]


def say(t: float, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0) -> Entry:
    return {"t": t, "command": {"source": "teleop", "vx": vx, "vy": vy, "wz": wz}}


def die(t: float, motor: str, kind: str = "torque_lost") -> Entry:
    return {"t": t, "fault": {"kind": kind, "motor": motor}}


def driven(config: RobotConfig, *entries: Entry, seconds: float) -> list[Moment]:
    script = {"robot": "omni4", "seconds": seconds, "seed": 1, "at": [say(0.3), *entries]}
    moments: list[Moment] = []
    run_scenario(Scenario.model_validate(script), config, watch=moments.append)
    return moments


def between(moments: Sequence[Moment], start: float, end: float) -> list[Moment]:
    return [one for one in moments if start <= one.t < end]


def modes(moments: Sequence[Moment]) -> list[Mode]:
    return [mode for mode, _ in groupby(one.outputs.mode for one in moments)]


def told(moments: Sequence[Moment]) -> list[str]:
    return [event.code for one in moments for event in one.outputs.events]


def accelerations(moments: Sequence[Moment]) -> list[float]:
    """Of the setpoint along the ground, m/s^2."""
    ways = [one.outputs.trace.setpoint for one in moments]
    return [math.hypot(b.vx - a.vx, b.vy - a.vy) / PERIOD for a, b in pairwise(ways)]


# -- one motor (Rojas 2005, section 11; acceptance R7)


@pytest.mark.parametrize("motor", MOTORS)
def test_without_one_motor_it_drives_everything_at_half_the_acceleration(motor: str) -> None:
    """R7 by the whole path: any motion is reproduced without the dead wheel; 2 m/s^2 and 6 rad/s^2 become 1 and 3."""
    moments = driven(
        OMNI4, die(0.9, motor, "power_off"), say(1.0, 1.0), say(2.6, 0.0, -0.8), say(4.4, 0.3, 0.3, 1.5), seconds=6.9
    )
    going = between(moments, 1.0, 6.9)
    assert {one.outputs.mode for one in going} == {Mode.DEGRADED}
    place = MOTORS.index(motor)
    for one in going:
        assert one.outputs.trace.wheel_setpoints[place] is None
    assert max(accelerations(between(moments, 1.0, 2.6))) == pytest.approx(1.0, rel=1e-6)
    for t, twist in ((2.5, (1.0, 0.0, 0.0)), (4.3, (0.0, -0.8, 0.0)), (6.8, (0.3, 0.3, 1.5))):
        now = next(one for one in moments if one.t >= t)
        assert now.outputs.trace.setpoint == pytest.approx(twist, abs=1e-9)
        assert now.truth.twist == pytest.approx(twist, abs=0.06)


def test_with_two_motors_dead_it_refuses_to_drive_unless_the_robot_file_says_limp() -> None:
    moments = driven(OMNI4, say(0.6, 1.0), die(1.6, MOTORS[0]), die(2.6, MOTORS[2]), say(5.5), seconds=6.0)
    assert modes(moments)[-1] is Mode.FAULT
    assert told(moments).count("fault_torque_lost") == 2


@pytest.mark.parametrize(
    ("way", "limit", "share"),
    [
        (0.0, 2.0, 0.5),
        (45.0, 1.5 * math.sqrt(2.0), 1.414 / 1.793),  # of 1.793 effective motors 1.414 are left
        (135.0, 1.5 * math.sqrt(2.0), 0.5),
    ],
)
def test_it_brakes_by_what_the_motors_left_give_along_its_way(way: float, limit: float, share: float) -> None:
    """front_left dead, then nobody commands any more. `limit`: m/s^2 along this way, in degrees, with all of them."""
    vx, vy = math.cos(math.radians(way)), math.sin(math.radians(way))
    dead = die(1.5, MOTORS[0], "power_off")
    moments = driven(OMNI4, say(0.6, vx, vy), dead, {"t": 2.4, "silence": "teleop"}, seconds=5.0)
    stopping = [one for one in moments if one.outputs.mode is Mode.STOPPING]
    assert max(accelerations(stopping)) == pytest.approx(share * limit, rel=2e-3)
    assert modes(moments)[-1] is Mode.IDLE


def test_slip_is_still_seen_while_the_dead_wheel_tells_its_speed() -> None:
    """Four speeds of three ways to move check each other, whoever pushes; three do not."""
    for kind, seen in (("torque_lost", True), ("cable_out", False)):
        oil = {"t": 3.2, "fault": {"kind": "friction", "value": 0.05, "motor": MOTORS[2]}}
        moments = driven(OMNI4, say(0.6, 1.0), die(1.6, MOTORS[0], kind), say(3.0, -1.0), oil, seconds=4.6)
        assert modes(moments)[-1] is Mode.DEGRADED
        late = between(moments, 3.2, 4.6)
        assert ("slip" in told(late)) is seen
        assert {one.outputs.trace.residual is not None for one in late} == {seen}


# -- and back

HEALED = {"power_off": "power_on", "cable_out": "cable_in", "encoder_frozen": "clear", "torque_lost": "clear"}


def healed_at_speed(kind: str) -> list[Moment]:
    """front_left is lost at 1.6 s and well at 2.4 s; a reset is asked for at speed, and one at rest before a zero."""
    return driven(
        OMNI4,
        say(0.6, 1.0, 0.2),
        die(1.6, MOTORS[0], kind),
        die(2.4, MOTORS[0], HEALED[kind]),
        {"t": 2.8, "request": "reset"},
        say(3.0, 0.5, 0.5),
        {"t": 3.2, "silence": "teleop"},
        {"t": 5.5, "request": "reset"},
        say(5.8),
        say(6.1, 0.5),
        seconds=6.3,
    )


def assert_back_by_rest_reset_and_zero_alone(moments: Sequence[Moment], *, latched: bool) -> None:
    lost = [one for one in between(moments, 1.9, 5.8) if one.outputs.mode in (Mode.DEGRADED, Mode.STOPPING)]
    assert {one.outputs.mode for one in between(moments, 1.9, 3.2)} == {Mode.DEGRADED}
    assert {one.outputs.trace.wheel_setpoints[0] for one in lost} == {None}
    replies = [reply.ok for one in moments for reply in one.outputs.replies]
    assert replies == [False, True]
    resting = between(moments, 5.4, 5.5)
    assert modes(resting) == [Mode.FAULT if latched else Mode.IDLE]
    assert {one.outputs.mode for one in between(moments, 5.55, 5.8)} == {Mode.IDLE}
    assert moments[-1].outputs.mode is Mode.DRIVE
    assert None not in moments[-1].outputs.trace.wheel_setpoints


@pytest.mark.parametrize("kind", HEALED)
def test_what_was_lost_comes_back_at_rest_by_a_zero_and_where_it_is_latched_a_reset(kind: str) -> None:
    latched = kind in ("encoder_frozen", "torque_lost")
    assert_back_by_rest_reset_and_zero_alone(healed_at_speed(kind), latched=latched)


@pytest.mark.pure_python
@pytest.mark.parametrize(
    ("kind", "rule"), [("power_off", "lost"), ("torque_lost", "latched"), ("torque_lost", "reset")]
)
def test_without_the_rule_it_comes_back_at_speed(monkeypatch: pytest.MonkeyPatch, kind: str, rule: str) -> None:
    """Forgotten at once: that it was lost, that its fault is latched too; or a reset is granted at speed."""
    if rule == "reset":
        monkeypatch.setattr(Engine, "_refusal_of_reset", lambda self, now_ns, *, estop: None)
    else:
        judge = HealthMonitor._judge

        def judged(self: HealthMonitor, present: Sequence[Fault]) -> Health:
            self._lost.clear()
            if rule == "latched":
                self._latched.clear()
            return judge(self, present)

        monkeypatch.setattr(HealthMonitor, "_judge", judged)
    with pytest.raises(AssertionError):
        assert_back_by_rest_reset_and_zero_alone(healed_at_speed(kind), latched=rule != "lost")


# -- two and three


def kinetic_energy(twist: Sequence[float]) -> float:
    """25 kg, 0.9 kg m^2."""
    vx, vy, wz = twist
    return 0.5 * (25.0 * (vx * vx + vy * vy) + 0.9 * wz * wz)


def wheel(motor: str, twist: Sequence[float]) -> float:
    """Rim speed, m/s: axles at 60, 120, 240 and 300 degrees, 0.2 m from the middle."""
    angle = math.radians({"front_left": 60, "rear_left": 120, "rear_right": 240, "front_right": 300}[motor])
    return -math.sin(angle) * twist[0] + math.cos(angle) * twist[1] + 0.2 * twist[2]


ORDERS = [pair for pair in permutations(MOTORS, 2) if "left" in pair[0]]  # the robot is its own mirror image
THREE = [MOTORS[:3], (MOTORS[3], MOTORS[1], MOTORS[0])]


@pytest.mark.parametrize("lost", [*ORDERS, *THREE], ids="-".join)
def test_two_and_three_lost_one_after_the_other(lost: tuple[str, ...]) -> None:
    """They are named and nobody else; the nearest is driven that is left, the error told, and it comes to rest.

    The nearest: what it is short of the command is at right angles, in the kinetic energy, to what it drives; and the
    wheels that are left turn as the setpoint has it.
    """
    courses = [(-0.3, 0.4, 0.5), (0.5, -0.3, -0.5), (0.2, 0.1, 0.0)]
    entries = [say(0.6, 0.5, 0.3)]
    for place, motor in enumerate(lost):
        entries += [die(1.6 + 0.9 * place, motor), say(1.8 + 0.9 * place, *courses[place])]
    entries += [say(4.3, 0.2, 0.1, 0.2), {"t": 5.5, "silence": "teleop"}]
    moments = driven(LIMPING, *entries, seconds=8.0)
    blamed = [event.text.partition(":")[0] for one in moments for event in one.outputs.events if "lost" in event.code]
    assert tuple(blamed) == lost
    if set(lost) == set(MOTORS[1:3]):
        return  # see below: led by its front wheels it turns away
    left = [motor for motor in MOTORS if motor not in lost]
    limping = between(moments, 5.2, 5.5)
    assert modes(limping) == [Mode.DEGRADED]
    trace = limping[-1].outputs.trace
    short = [a - b for a, b in zip(trace.target, trace.setpoint, strict=True)]
    assert kinetic_energy(trace.setpoint) + kinetic_energy(short) == pytest.approx(kinetic_energy(trace.target), 0.05)
    for motor in left:
        assert wheel(motor, limping[-1].truth.twist) == pytest.approx(wheel(motor, trace.setpoint), abs=0.02)
        assert abs(wheel(motor, moments[-1].truth.twist)) < 0.02
    status = next(one.outputs.status for one in reversed(limping) if one.outputs.status)
    assert status is not None
    assert (status.ability.rank, len(status.ability.lost)) == (len(left), 3 - len(left))
    assert "limp" in status.limits_active
    assert modes(moments)[-1] in (Mode.STOPPING, Mode.IDLE, Mode.FAULT)
    assert max(abs(one.truth.twist.wz) for one in between(moments, 1.6, 8.0)) < 2.0


def led_by_its_front_wheels() -> list[Moment]:
    """Both rear motors lost at 1 m/s, and on ahead: it turns away by itself, e-fold every half metre."""
    return driven(
        LIMPING,
        say(0.6, 1.0, 0.1),
        die(1.8, MOTORS[1]),
        say(2.2, 0.6, 0.4, 0.5),
        die(2.6, MOTORS[2]),
        say(3.2, 1.0),
        seconds=7.5,
    )


def test_limping_ends_where_it_comes_to_move_as_no_motor_left_can_change() -> None:
    """It brakes, whatever goes on to be commanded."""
    moments = led_by_its_front_wheels()
    (end,) = [one.t for one in moments if "limp_ended" in told([one])]
    assert Mode.DEGRADED in modes(between(moments, 2.6, end))
    assert Mode.DEGRADED not in modes(between(moments, end + 0.01, 7.5))
    speeds = [math.hypot(*one.outputs.trace.setpoint[:2]) for one in between(moments, end, 7.5)]
    assert all(after <= before for before, after in pairwise(speeds))
    assert max(abs(one.truth.twist.wz) for one in between(moments, 2.6, 7.5)) < 1.2


@pytest.mark.pure_python
def test_without_that_it_turns_faster_and_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LimpWatch, "look", lambda self, reach, rates: None)
    moments = led_by_its_front_wheels()
    assert max(abs(one.truth.twist.wz) for one in between(moments, 2.6, 7.5)) > 1.2


LOST = Reachable(
    basis=((0.2, 0.0, 0.0),),
    lost=((0.0, 0.2, 0.0), (0.0, 0.0, 1.0)),
    projection=((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
)


def test_only_what_grows_ends_it() -> None:
    """Half of 0.3 of 2, 1.5 m/s and 4 rad/s beyond the least since it limps; what is driven does not count."""
    watch = LimpWatch((2.0, 1.5, 4.0), 0.3)
    for wz in (2.0, 1.0, 0.4, 0.9):
        assert watch.look(LOST, (2.0, 0.0, wz)) is None
    assert watch.look(LOST, (0.0, 0.0, -1.02)) is not None
    assert watch.look(LOST, (0.0, 0.39, 0.0)) is not None
    assert watch.look(None, (0.0, 0.37, 0.0)) is None
    assert watch.look(LOST, (0.0, 1.4, 0.0)) is None, "it begins anew"
    assert watch.look(LOST, None) is None
