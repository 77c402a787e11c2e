"""Each loss of a motor or its encoder, at speed, pushed, turning about the axle and pulled, compensated and not.

By the closed loop, with motors that have limits. How soon a loss is seen, how far the robot leaves its course by it
within two seconds, that no wheel is told to change faster than it may, what the robot file makes of it, and the way
back. Course bounds are twice what was measured, 2026-11-26, moby at 100 Hz.
"""

import math
from collections.abc import Mapping
from itertools import pairwise, product
from typing import NamedTuple

import pytest

from gateway.config import RobotConfig, parse
from gateway.types import Mode
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from tests.world import robot_text

RATE = 100.0  # Hz
MOST = (60.0, 60.0, 20.0)  # rad/s^2
LOSS_S = 2.2  # by then it drives as it is told
WATCHED_S = 2.0
COMPENSATION = "[robot.compensation]\ngain = 2.0\nregion = 1.57\n\n[robot.body]"
LIMITS = "motor_acceleration = { left = 60.0, right = 60.0, platform = 20.0 }\n\n[[bus]]"
DEGRADED = '[degraded]\nmotor_lost = "POLICY"\nencoder_lost = "POLICY"\nspeed = 0.3\n\n[limits]'

Entry = dict[str, object]
Twisted = tuple[float, float, float]


class Region(NamedTuple):
    """Where the joint stands at the start, what is then commanded, and the cosines of gamma at the loss."""

    joint: float
    twist: Twisted
    least: float
    most: float


REGIONS = {
    "push": Region(-math.pi / 2 + 0.02, (0.0, 0.9, 0.0), 0.99, 1.0),
    "turning": Region(0.0, (0.0, 0.25, 1.0), -0.05, 0.05),  # a radius of d1: about the middle of the axle
    "pull": Region(math.pi / 2 - 0.01, (0.0, 0.9, 0.0), -1.0, -0.9),
}
Place = tuple[str, bool]  # region, compensated
EVERYWHERE: tuple[Place, ...] = tuple(product(REGIONS, (False, True)))


class Seen(NamedTuple):
    """Within how many seconds, and the mode that follows where the robot may limp."""

    within: float
    mode: Mode = Mode.FAULT


class Loss(NamedTuple):
    """`seen`: where; elsewhere nothing tells it, and the robot drives on. `course`: m."""

    kind: str
    motor: str
    course: float
    seen: Mapping[Place, Seen]


LOSSES = (
    # Motor and encoder: nothing is heard of them any more. Nor does what is left see how the robot moves.
    Loss("cable_out", "left", 0.7, dict.fromkeys(EVERYWHERE, Seen(0.06))),
    Loss("cable_out", "platform", 0.5, dict.fromkeys(EVERYWHERE, Seen(0.06))),
    Loss("power_off", "left", 0.6, dict.fromkeys(EVERYWHERE, Seen(0.06))),
    Loss("power_off", "platform", 0.5, dict.fromkeys(EVERYWHERE, Seen(0.06))),
    # The encoder, of a motor that is alive. A joint that is to stand looks well until its controller winds up.
    Loss("encoder_frozen", "left", 2.3, dict.fromkeys(EVERYWHERE, Seen(0.05))),
    Loss(
        "encoder_frozen",
        "platform",
        0.5,
        {
            ("push", False): Seen(1.8),
            ("push", True): Seen(1.8),
            ("pull", False): Seen(0.05),
            ("pull", True): Seen(3.1),
        },
    ),
    # The motor, of an encoder that is alive: seen once it is asked for what the other motors do not do as well. In
    # line with them a wheel rolls along, and one wheel of two says nothing that an overload would not say too.
    Loss(
        "torque_lost",
        "left",
        1.05,
        {
            ("turning", False): Seen(1.2, Mode.DEGRADED),
            ("turning", True): Seen(1.2, Mode.DEGRADED),
            ("pull", True): Seen(1.8),  # it is dragged the other way round: a runaway
        },
    ),
    Loss(
        "torque_lost",
        "platform",
        1.7,
        {
            ("push", False): Seen(3.0),  # its controller winds up, as with a frozen encoder
            ("push", True): Seen(3.0),
            ("pull", False): Seen(2.0, Mode.DEGRADED),
        },
    ),
)


def robot(*, compensated: bool, policy: str = "limp") -> RobotConfig:
    text = robot_text("moby", rate_hz=RATE).replace("[[bus]]", LIMITS, 1)
    text = text.replace("[limits]", DEGRADED.replace("POLICY", policy), 1)
    return parse(text.replace("[robot.body]", COMPENSATION, 1) if compensated else text, "moby")


def command(t: float, twist: Twisted) -> Entry:
    vx, vy, wz = twist
    return {"t": t, "command": {"source": "teleop", "vx": vx, "vy": vy, "wz": wz}}


STILL: Twisted = (0.0, 0.0, 0.0)


def driven(config: RobotConfig, region: Region, *entries: Entry, seconds: float) -> list[Moment]:
    script = {
        "robot": "moby",
        "seconds": seconds,
        "seed": 1,
        "at": [command(0.3, STILL), command(0.6, region.twist), *entries],
        "start": {"joint": {"platform": region.joint}},
    }
    moments: list[Moment] = []
    run_scenario(Scenario.model_validate(script), config, watch=moments.append)
    return moments


def fault(t: float, kind: str, motor: str) -> Entry:
    return {"t": t, "fault": {"kind": kind, "motor": motor}}


def since(moments: list[Moment], t: float) -> list[Moment]:
    return [one for one in moments if one.t >= t]


def modes(moments: list[Moment]) -> list[Mode]:
    found: list[Mode] = []
    for one in moments:
        if not found or found[-1] is not one.outputs.mode:
            found.append(one.outputs.mode)
    return found


def worst_step(moments: list[Moment]) -> float:
    """The largest change of what a motor is told, in units of its limit."""
    worst = 0.0
    for before, now in pairwise(moments):
        told = zip(before.outputs.trace.wheel_setpoints, now.outputs.trace.wheel_setpoints, MOST, strict=True)
        worst = max([worst, *(abs(b - a) * RATE / most for a, b, most in told if a is not None and b is not None)])
    return worst


def off_course(moments: list[Moment]) -> float:
    """How far the robot gets from where its setpoints lead from the first of these moments on, m."""
    x, y, heading = moments[0].truth.pose
    worst = 0.0
    for one in moments:
        vx, vy, wz = one.outputs.trace.setpoint
        s, c = math.sin(heading), math.cos(heading)
        x, y, heading = x + (c * vx - s * vy) / RATE, y + (s * vx + c * vy) / RATE, heading + wz / RATE
        worst = max(worst, math.hypot(one.truth.pose.x - x, one.truth.pose.y - y))
    return worst


def cosine(moment: Moment) -> float:
    """Of gamma, from the true motion."""
    vx, vy, _ = moment.truth.twist
    return math.cos(math.atan2(vy, vx) + moment.truth.joint_angles[2])


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: f"{loss.kind} {loss.motor}")
def test_a_loss_at_speed(loss: Loss) -> None:
    for place in EVERYWHERE:
        region, compensated = REGIONS[place[0]], place[1]
        again = (command(5.4, STILL), command(5.7, region.twist))  # as a person would try
        entry = fault(LOSS_S, loss.kind, loss.motor)
        moments = driven(robot(compensated=compensated), region, entry, *again, seconds=6.2)
        after = since(moments, LOSS_S)
        assert region.least <= cosine(after[0]) <= region.most, place
        assert after[0].outputs.mode is Mode.DRIVE
        assert worst_step(moments) <= 1.0 + 1e-6, place
        assert off_course([one for one in after if one.t < LOSS_S + WATCHED_S]) <= loss.course, place
        seen = loss.seen.get(place)
        if seen is None:
            assert modes([one for one in after if one.t < 5.4]) == [Mode.DRIVE], place
            continue
        first = next(one for one in after if one.outputs.mode is not Mode.DRIVE)
        assert first.outputs.mode is seen.mode, place
        assert first.t - LOSS_S <= seen.within, place
        assert Mode.DRIVE not in modes(since(moments, first.t)), place  # not by itself, nor by a zero


@pytest.mark.parametrize("place", [("turning", False), ("turning", True)])
def test_a_robot_that_may_not_limp_stops_instead(place: Place) -> None:
    config = robot(compensated=place[1], policy="stop")
    moments = driven(config, REGIONS[place[0]], fault(LOSS_S, "torque_lost", "left"), seconds=7.0)
    assert modes(since(moments, LOSS_S)) == [Mode.DRIVE, Mode.FAULT]
    assert worst_step(moments) <= 1.0 + 1e-6
    assert max(map(abs, moments[-1].truth.twist)) < 0.03


@pytest.mark.parametrize("compensated", [False, True])
def test_what_was_lost_comes_back_at_rest_by_a_reset_and_a_zero_alone(compensated: bool) -> None:
    """The wheel pushes again while the robot limps: it is not driven, no reset is granted before rest."""
    moments = driven(
        robot(compensated=compensated),
        REGIONS["turning"],
        fault(LOSS_S, "torque_lost", "left"),
        fault(4.0, "clear", "left"),
        {"t": 4.5, "request": "reset"},
        {"t": 5.0, "silence": "teleop"},
        {"t": 10.0, "request": "reset"},
        command(10.5, (0.0, 0.25, 0.0)),
        command(11.0, STILL),
        command(12.0, (0.0, 0.25, 0.0)),
        seconds=14.0,
    )
    limping = [one for one in moments if one.outputs.mode is Mode.DEGRADED]
    assert limping[0].t < 4.0
    assert limping[-1].t > 5.0
    assert {one.outputs.trace.wheel_setpoints[0] for one in limping} == {None}
    assert all("limp" in one.outputs.status.limits_active for one in limping if one.outputs.status)
    assert max(math.hypot(*one.outputs.trace.setpoint[:2]) for one in since(limping, 4.5)) <= 0.3 * 1.2 * math.sqrt(2.0)
    replies = [(round(one.t, 1), reply.ok) for one in moments for reply in one.outputs.replies]
    assert replies == [(4.5, False), (10.0, True)]
    assert modes([one for one in moments if 5.5 < one.t < 11.0]) in (
        [Mode.STOPPING, Mode.IDLE, Mode.FAULT, Mode.IDLE],
        [Mode.STOPPING, Mode.IDLE],
    )
    assert modes(since(moments, 11.0))[-1] is Mode.DRIVE
    assert max(map(abs, moments[-1].truth.twist)) == pytest.approx(0.25, abs=0.01)


def test_a_motor_that_is_heard_again_waits_for_rest_and_a_zero() -> None:
    moments = driven(
        robot(compensated=True),
        REGIONS["pull"],
        fault(LOSS_S, "cable_out", "left"),
        fault(2.6, "cable_in", "left"),
        command(9.0005, STILL),
        command(10.0, (0.0, 0.3, 0.0)),
        seconds=11.5,
    )
    between = [one for one in moments if LOSS_S + 0.1 <= one.t < 9.0]
    assert modes(between) == [Mode.FAULT, Mode.IDLE]
    assert {one.outputs.trace.wheel_setpoints[0] for one in between} == {None}
    assert modes(since(moments, 9.0)) == [Mode.IDLE, Mode.STARTING, Mode.DRIVE]
    assert worst_step(moments) <= 1.0 + 1e-6


def test_after_a_frozen_encoder_the_way_back_is_a_reset_at_rest() -> None:
    moments = driven(
        robot(compensated=True),
        REGIONS["pull"],
        fault(LOSS_S, "encoder_frozen", "left"),
        fault(7.0, "clear", "left"),
        command(7.5, STILL),
        {"t": 8.0, "request": "reset"},
        command(9.0005, STILL),
        command(10.0, (0.0, 0.3, 0.0)),
        seconds=11.5,
    )
    assert modes([one for one in moments if LOSS_S + 0.1 <= one.t < 8.0]) == [Mode.FAULT]
    assert [reply.ok for one in moments for reply in one.outputs.replies] == [True]
    assert modes(since(moments, 8.5))[-1] is Mode.DRIVE
