"""Driving with what is left: by the closed loop with simulated controllers, and what the robot says of itself."""

import math
from itertools import pairwise

import pytest

from gateway.config import ConfigError, RobotConfig, parse
from gateway.control.drive_law import Measured
from gateway.core.ability import Abilities
from gateway.core.assembly import build
from gateway.core.health import Health
from gateway.types import AbilityStatus, EffectiveMotors, Mode, Twist
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from tests.world import robot_text

LIMP = '[degraded]\nmotor_lost = "limp"\nspeed = 0.3\n\n[limits]'


BOTH = LIMP.replace("motor_lost", 'encoder_lost = "limp"\nmotor_lost')


def limping(name: str, *edits: tuple[str, str]) -> RobotConfig:
    text = robot_text(name).replace("[limits]", LIMP, 1)
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    return parse(text, name)


def driven(config: RobotConfig, *entries: dict[str, object], seconds: float, **start: float) -> list[Moment]:
    """A drive of one commander that began with zeros."""
    still = {"t": 0.3, "command": {"source": "teleop", "vx": 0.0, "vy": 0.0, "wz": 0.0}}
    script = Scenario.model_validate(
        {"robot": config.robot.name, "seconds": seconds, "seed": 1, "at": [still, *entries], "start": {"joint": start}}
    )
    moments: list[Moment] = []
    run_scenario(script, config, watch=moments.append)
    return moments


def command(t: float, vx: float, vy: float, wz: float) -> dict[str, object]:
    return {"t": t, "command": {"source": "teleop", "vx": vx, "vy": vy, "wz": wz}}


def lost(t: float, motor: str, kind: str = "torque_lost") -> dict[str, object]:
    return {"t": t, "fault": {"kind": kind, "motor": motor}}


def modes(moments: list[Moment]) -> list[Mode]:
    found: list[Mode] = []
    for moment in moments:
        if not found or found[-1] is not moment.outputs.mode:
            found.append(moment.outputs.mode)
    return found


def at(moments: list[Moment], seconds: float) -> Moment:
    return next(moment for moment in moments if moment.outputs.trace is not None and moment.t >= seconds)


def steps(moments: list[Moment], index: int) -> float:
    """The largest change of one wheel's setpoint from cycle to cycle while it is driven, rad/s."""
    told = [moment.outputs.trace.wheel_setpoints[index] for moment in moments]
    return max(abs(b - a) for a, b in pairwise(told) if a is not None and b is not None)


@pytest.mark.parametrize("joint", [0.0, 2.0, math.pi], ids=["push", "between", "pull"])
def test_moby_drives_on_without_its_platform_motor(joint: float) -> None:
    """Its way is kept, its yaw lost; 0.3 of 1.2 m/s; no step of a wheel; and it comes to rest and to IDLE, or FAULT."""
    moments = driven(
        limping("moby"),
        command(1.0, 0.4, 0.0, 0.4),
        lost(2.0, "platform"),
        command(2.2, 0.4, 0.3, -0.4),
        command(7.0, 0.0, 0.0, 0.0),
        seconds=10.0,
        platform=joint,
    )
    assert modes(moments)[:4] == [Mode.IDLE, Mode.STARTING, Mode.DRIVE, Mode.DEGRADED]
    going = at(moments, 6.5)
    assert going.outputs.mode is Mode.DEGRADED
    assert going.outputs.trace.setpoint[:2] == pytest.approx((0.36, 0.27), abs=1e-3)
    assert going.outputs.trace.setpoint.wz == pytest.approx(0.0, abs=1e-9)
    assert going.truth.twist[:2] == pytest.approx((0.36, 0.27), abs=0.01)
    assert going.outputs.trace.wheel_setpoints[2] is None
    for wheel in (0, 1):
        assert steps(moments, wheel) < 0.15  # rad/s; 0.8 m/s^2 at 4 ms is 0.032 at the rim, and the chassis turns
    assert at(moments, 9.9).truth.twist == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_the_same_robot_told_to_stop_stops() -> None:
    """Without a word in the robot file the loss of a direction is a fault, as before."""
    config = parse(robot_text("moby"), "moby")
    moments = driven(
        config, command(1.0, 0.4, 0.0, 0.4), lost(2.0, "platform"), command(2.2, 0.4, 0.3, -0.4), seconds=8
    )
    assert Mode.DEGRADED not in modes(moments)
    assert Mode.FAULT in modes(moments)
    assert at(moments, 7.9).truth.twist == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


@pytest.mark.parametrize("name", ["moby", "omni4"])
def test_a_motor_that_nothing_is_heard_of_any_more_is_the_loss_of_an_encoder(name: str) -> None:
    """motor_lost = "limp" alone does not let a robot drive that has lost what tells how it turns."""
    config = limping(name)
    first, second = config.robot.motor_names()[:2]
    moments = driven(
        config, command(1.0, 0.4, 0.1, 0.2), lost(2.0, first, "cable_out"), lost(2.0, second, "cable_out"), seconds=6.0
    )
    assert Mode.FAULT in modes(moments)
    assert at(moments, 5.9).outputs.mode is not Mode.DEGRADED


def test_omni4_with_two_motors_left_drives_what_they_reach() -> None:
    """Two opposite wheels: the line across both is lost; along theirs and in yaw it goes on, as the plant shows."""
    config = limping("omni4")
    names = config.robot.motor_names()
    moments = driven(
        config,
        command(1.0, 0.5, -0.5, 0.0),
        lost(2.0, names[1]),
        command(2.1, 0.3, -0.5, 1.0),
        lost(3.0, names[3]),
        command(3.1, 0.5, -0.3, -1.0),
        command(4.0, 0.3, -0.5, 0.2),
        seconds=8.0,
    )
    last = moments[-1].outputs
    if last.mode is not Mode.DEGRADED:
        pytest.fail(f"{modes(moments)}")
    setpoint, truth = last.trace.setpoint, moments[-1].truth.twist
    wheels = build(config).kinematics.wheel_speeds(setpoint, ()) or []
    really = build(config).kinematics.wheel_speeds(truth, ()) or []
    for index in (0, 2):
        assert really[index] == pytest.approx(wheels[index], abs=0.3)


def test_what_it_can_do_is_in_its_state() -> None:
    moments = driven(
        limping("moby"), command(1.0, 0.4, 0.0, 0.4), lost(2.0, "platform"), command(2.2, 0.4, 0.3, -0.4), seconds=6.0
    )
    full = next(one.outputs.status for one in moments if one.outputs.status and one.outputs.mode is Mode.DRIVE)
    assert full is not None
    assert full.ability == AbilityStatus(3, 1.0, 1.0, (), ()), "its geometry turns, so no effective motors"
    status = next(one.outputs.status for one in reversed(moments) if one.outputs.status)
    assert status is not None
    assert "limp" in status.limits_active
    ability = status.ability
    assert (ability.rank, ability.speed) == (2, 0.3)
    assert 0.0 < ability.effort <= 1.0
    for twist in ability.reachable:
        assert twist.wz == pytest.approx(0.0, abs=1e-9)
        assert max(abs(twist.vx), abs(twist.vy)) == pytest.approx(0.36)
    (yaw,) = ability.lost
    assert yaw == pytest.approx(Twist(0.0, 0.0, 0.3))


def test_the_extreme_twists_that_are_told_are_what_the_robot_then_drives() -> None:
    """Platform motor lost: each way that is left, forwards and backwards, at its end."""
    config = limping("moby")
    begin = (command(1.0, 0.4, 0.0, 0.4), lost(2.0, "platform"), command(2.2, 0.4, 0.3, -0.4))
    status = next(one.outputs.status for one in reversed(driven(config, *begin, seconds=5.0)) if one.outputs.status)
    assert status is not None
    for twist in status.ability.reachable:
        for sign in (1.0, -1.0):
            vx, vy = sign * twist.vx, sign * twist.vy
            last = driven(config, *begin, command(5.0, vx, vy, 0.0), seconds=9.0)[-1]
            assert last.outputs.mode is Mode.DEGRADED
            assert last.truth.twist[:2] == pytest.approx((vx, vy), abs=0.01)


def test_a_joint_that_is_held_when_its_motor_is_lost_turns_the_platform_with_the_chassis() -> None:
    """`when_lost = "held"`: two ways are left, and in each the platform turns at (n . v)/d1, d1 = 0.25 m."""
    config = limping("moby", ('name = "platform"\n', 'name = "platform"\nwhen_lost = "held"\n'))
    moments = driven(
        config, command(1.0, 0.4, 0.0, 0.4), lost(2.0, "platform"), command(2.2, 0.4, 0.3, -0.4), seconds=6.0
    )
    told = next(moment for moment in reversed(moments) if moment.outputs.status)
    assert told.outputs.status is not None
    ability, angle = told.outputs.status.ability, told.outputs.trace.wheel_positions[2]
    assert angle is not None
    assert ability.rank == 2
    for vx, vy, wz in ability.reachable:
        assert wz == pytest.approx((math.sin(angle) * vx + math.cos(angle) * vy) / 0.25, abs=1e-9)


@pytest.mark.parametrize("joint", [0.0, 2.0, math.pi], ids=["push", "between", "pull"])
def test_moby_without_one_wheel_drives_nothing_it_does_not_reach_and_comes_to_rest(joint: float) -> None:
    """The left wheel rolls along: what the other wheel and the joint push is all that is asked of them."""
    config = limping("moby")
    moments = driven(
        config,
        command(1.0, 0.4, 0.0, 0.2),
        lost(2.0, "left"),
        command(2.1, -0.3, 0.3, 0.2),
        command(6.0, 0.0, 0.0, 0.0),
        seconds=10.0,
        platform=joint,
    )
    assert Mode.DEGRADED in modes(moments)
    for moment in moments:
        if moment.outputs.mode is Mode.DEGRADED:
            assert moment.outputs.trace.wheel_setpoints[0] is None
            assert max(abs(moment.truth.twist.vx), abs(moment.truth.twist.vy)) < 0.8
    assert steps(moments, 1) < 0.15
    assert moments[-1].truth.twist == pytest.approx((0.0, 0.0, 0.0), abs=0.03)


def test_limp_needs_a_share_of_speed() -> None:
    for bad in ("0.0", "1.1", "-0.3"):
        text = robot_text("moby").replace("[limits]", LIMP.replace("0.3", bad), 1)
        with pytest.raises(ConfigError, match=r"degraded\.speed"):
            parse(text, "moby")


def test_a_frozen_encoder_spoils_neither_speed_nor_way_of_the_others() -> None:
    """omni4 turns and drives on with three; what the fourth goes on telling is left out, its pose stays right."""
    config = parse(robot_text("omni4"), "omni4")
    moments = driven(
        config, command(0.6, 0.6, 0.2, 0.5), lost(2.0, config.robot.motor_names()[0], "encoder_frozen"), seconds=6.0
    )
    assert moments[-1].outputs.mode is Mode.DEGRADED
    found = at(moments, 2.2).outputs  # by then it is found
    assert found.mode is Mode.DEGRADED
    for moment in moments:
        if moment.t >= 2.2:
            assert moment.outputs.trace.measured == pytest.approx(moment.truth.twist, abs=0.02)
    missed = [a - b for a, b in zip(moments[-1].outputs.trace.pose, moments[-1].truth.pose, strict=True)]
    assert missed == pytest.approx([0.0, 0.0, 0.0], abs=0.02)


@pytest.mark.parametrize("fault", ["encoder_frozen", "cable_out", "power_off"])
def test_nothing_limps_by_a_joint_angle_that_is_not_known(fault: str) -> None:
    """Whatever the robot file lets it: a platform that tells nothing, or the same for ever, leaves no geometry."""
    config = parse(robot_text("moby").replace("[limits]", BOTH, 1), "moby")
    moments = driven(
        config, command(1.0, 0.3, 0.3, 0.8), lost(2.0, "platform", fault), command(3.0, 0.3, -0.3, -0.8), seconds=7.0
    )
    assert Mode.FAULT in modes(moments)
    assert moments[-1].outputs.mode is not Mode.DEGRADED
    assert moments[-1].truth.twist[:2] == pytest.approx((0.0, 0.0), abs=0.02)


@pytest.mark.parametrize("fault", ["cable_out", "encoder_frozen"])
def test_nothing_limps_that_does_not_see_how_it_moves(fault: str) -> None:
    """moby without a word from one wheel, or with the same word for ever: its motion is not determined, so it rests."""
    config = parse(robot_text("moby").replace("[limits]", BOTH, 1), "moby")
    moments = driven(config, command(1.0, 0.4, 0.0, 0.2), lost(2.0, "left", fault), seconds=8.0)
    assert Mode.DEGRADED not in modes(moments)
    assert Mode.FAULT in modes(moments)
    assert moments[-1].truth.twist == pytest.approx((0.0, 0.0, 0.0), abs=0.03)


# Of the 30-degree layout, forward to 165 degrees to the left, by 4 sin cos/(|cos psi| cos phi + |sin psi| sin phi),
# phi = 30 degrees from the left: forward 4 cos 30, sideways 4 sin 30.
EVERY = (3.464, 2.449, 2.0, 1.793, 1.732, 1.793, 2.0, 1.793, 1.732, 1.793, 2.0, 2.449)


def test_how_hard_it_pushes_is_in_its_state_with_the_motors_that_are_left() -> None:
    """omni4: all motors; one lost: half of it forward and sideways; two lost, and not called driving: nothing."""
    moments = driven(
        parse(robot_text("omni4"), "omni4"),
        command(1.0, 0.4, 0.0, 0.0),
        lost(2.0, "rear_left", "power_off"),
        lost(4.0, "rear_right", "power_off"),
        seconds=6.0,
    )
    told = {one.t: one.outputs.status.ability.effective_motors for one in moments if one.outputs.status}
    whole, reduced, nothing = (
        next(motors for t, motors in told.items() if motors is not None and t > since) for since in (1.5, 2.6, 4.6)
    )
    assert whole == EffectiveMotors(EVERY, EVERY)
    assert reduced.every == EVERY
    assert (reduced.usable[0], reduced.usable[6]) == (1.732, 1.0)
    assert all(left < every + 1e-9 for left, every in zip(reduced.usable, EVERY, strict=True))
    assert nothing == EffectiveMotors(EVERY, (0.0,) * 12)


ALONE = (-0.866 / 25.0, 0.5 / 25.0, 0.2 / 0.9)  # how front_left alone drives 25 kg and 0.9 kg m^2


@pytest.mark.parametrize(("strong", "way", "share"), [(4.5, (1.0, 0.0, 0.0), 0.5), (450.0, ALONE, 0.35)])
def test_a_stop_takes_at_most_three_times_as_long_however_strong_the_motor_was(
    strong: float, way: tuple[float, float, float], share: float
) -> None:
    """omni4 without front_left: half is left of four alike; hardly anything of what one alone could do."""
    config = parse(robot_text("omni4"), "omni4")
    abilities = Abilities(config, build(config))
    abilities._torques = (strong, 4.5, 4.5, 4.5)
    lost = (False, True, True, True)
    measured = Measured(0, 0.004, (0.0,) * 4, (0.0,) * 4, (0.0,) * 4, (0,) * 4, (0.0,) * 4, None, False, None, None, ())
    assert abilities.braking(Health(lost, lost, (True,) * 4, ()), measured, way) == pytest.approx(share)
    assert abilities.braking(Health(lost, lost, (True,) * 4, ()), measured, (0.0, 0.0, 0.0)) == 1.0
    none, well = (False,) * 4, (True,) * 4
    assert abilities.braking(Health(none, none, well, ()), measured, (1.0, 0.0, 0.0)) == 1.0
    assert abilities.braking(Health(well, well, well, ()), measured, (1.0, 0.0, 0.0)) == 1.0
