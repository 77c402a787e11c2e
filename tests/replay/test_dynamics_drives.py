"""M11 to M19 of science section 6 through the service: command, engine, CAN frames, simulated ODrive, all bodies.

The references are direct: kinematics, or torques that the model itself says. Through the service there are speed loops
that give way, frames that take their time and a joint angle that is a cycle old; so the figures differ, and here is by
how much. Bounds are about twice what was measured, unless the text names another source. The paper gives no numbers for
M15 to M19.
"""

from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from math import asin, atan2, cos, degrees, hypot, pi, remainder, sin, tau
from typing import NamedTuple

import pytest

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import parse
from gateway.core.engine import Engine
from gateway.types import (
    Event,
    Mode,
    Outputs,
    Pose,
    Request,
    RequestKind,
    Twist,
    TwistCommand,
    TwistFrame,
)
from replay.drive.closed_loop import ClosedLoop
from replay.sim.plants.contract import Point
from replay.sim.plants.offset_caster import OffsetCaster, parameters
from replay.sim.plants.offset_parameters import SETS
from tests.gateway.test_pull_drives import figure_9
from tests.world import robot_text

PULLED, PUSHED = pi / 2.0, -pi / 2.0  # swivel of a caster that trails, rad
STARTING = {"mode_starting", "mode_drive"}


class Seen(NamedTuple):
    """The true robot after a cycle, `t` s after the drive began."""

    t: float
    pose: Pose
    velocity: tuple[float, float]  # of the platform joint in the world, m/s
    chassis: float  # heading, rad
    torques: tuple[float, ...]
    rates: tuple[float, ...]  # of the joints, rad/s
    momentum: tuple[float, float]


class Drive:
    """moby with other limits, so that commands are followed as they come, on the plant of a set or of its file."""

    def __init__(
        self,
        *,
        heading: float,
        rate: float = 250.0,
        offset: float = 0.25,
        gain: float | None = None,
        torque: float = 75.0,
        swivel: float = PULLED,
        own: bool = False,
    ) -> None:
        """`heading`: of the chassis, rad; `torque`: limit of the wheels' motors; `own`: the plant of the robot file."""
        config = parse(_text(rate=rate, offset=offset, gain=gain, torque=torque), "moby")
        assert isinstance(config.robot, OffsetDifferentialRobot)
        model, drag = parameters(config.robot), config.robot.body.joint_drag
        if not own:
            model, drag = SETS["B"]._replace(axle_offset=offset), 0.0
        self.plant = OffsetCaster(model, swivel=swivel, drag=drag)
        self.loop = ClosedLoop(config, plant=self.plant, joint_angles={"platform": -heading})
        self.seen: list[Seen] = []
        self.events: list[tuple[float, Event]] = []
        self._begun_ns = self.loop.next_ns
        while self.loop.engine.mode is not Mode.DRIVE:
            assert len(self.seen) < rate, "it starts"
            self.cycle(0.0, 0.0)
        self.seen, self._begun_ns = [], self.loop.next_ns

    @property
    def engine(self) -> Engine:
        return self.loop.engine

    @property
    def alarms(self) -> list[tuple[float, str]]:
        return [(t, event.code) for t, event in self.events if event.code not in STARTING]

    def cycle(
        self, vx: float, vy: float, *, path_rate: float = 0.0, settings: Mapping[str, float] | None = None
    ) -> Outputs:
        """One, under a velocity in the world."""
        now_ns = self.loop.next_ns
        command = TwistCommand("teleop", Twist(vx, vy, 0.0), TwistFrame.ODOM, None, now_ns, path_rate=path_rate)
        requests = [
            Request(RequestKind.SET, 1, now_ns, setting=name, value=value) for name, value in (settings or {}).items()
        ]
        _, outputs = self.loop.cycle(commands=[command], requests=requests)
        t = (now_ns - self._begun_ns) / 1e9
        self.events += [(t, event) for event in outputs.events]
        truth = self.loop.bus.robot.truth
        s, c = sin(truth.pose.theta), cos(truth.pose.theta)
        velocity = c * truth.twist.vx - s * truth.twist.vy, s * truth.twist.vx + c * truth.twist.vy
        self.seen.append(
            Seen(
                t,
                truth.pose,
                velocity,
                truth.chassis_angle,
                truth.joint_torques,
                truth.joint_rates,
                self.plant.momentum,
            )
        )
        return outputs

    def off(self, t: float) -> float:
        """Degrees by which the chassis lies away from being pulled along x, at that time."""
        return degrees(remainder(next(one.chassis for one in self.seen if one.t >= t - 1e-9) - pi, tau))


def _text(*, rate: float, offset: float, gain: float | None, torque: float) -> str:
    text = robot_text("moby", rate_hz=rate)
    changes = {
        "axle_offset = 0.25 ": f"axle_offset = {offset} ",
        "acceleration = { vx = 0.8, vy = 0.8, ": "acceleration = { vx = 1000.0, vy = 1000.0, ",
        "jerk = { vx = 4.0, vy = 4.0, ": "jerk = { vx = 10000.0, vy = 10000.0, ",
        "left = 22.0, right = 22.0, platform = 7.0": "left = 35.0, right = 35.0, platform = 15.0",
        "max_torque = 75.0": f"max_torque = {torque}",
        "max_speed = 24.0": "max_speed = 40.0",
        "max_speed = 8.0": "max_speed = 20.0",
        "feedback_rate = 250.0": f"feedback_rate = {rate}",
    }
    if gain is not None:
        commented = "# [robot.compensation]\n# gain = 2.0\n# region = 1.57"
        changes[commented] = f"[robot.compensation]\ngain = {gain}\nregion = 1.57"
    for before, after in changes.items():
        assert before in text
        text = text.replace(before, after)
    return text


# -- figures 11 and 12 ------------------------------------------------------------------------------------------------


class Peaks(NamedTuple):
    """Of a drive along x: N m of a wheel, N of the ground; the caster's swivel and the chassis' heading at the end."""

    torque: float
    force: float
    swivel: float
    heading: float


@cache
def peaks(gain: float | None, *, own: bool = False) -> Peaks:
    """The trapezoid of section 7 in 6.72 s at 1 kHz, from 2 mrad off being pulled, the caster across at first."""
    rate, duration, top = 1000.0, 6.72, 1.2
    drive = Drive(heading=pi - 2e-3, rate=rate, gain=gain, swivel=0.0, own=own)
    for cycle in range(round(duration * rate)):
        t, growing = cycle / rate, 4.0 * top / duration
        drive.cycle(max(0.0, min(growing * t, top, growing * (duration - t))), 0.0)
    assert drive.alarms == []
    momenta = [one.momentum for one in drive.seen]
    forces = [hypot(b[0] - a[0], b[1] - a[1]) * rate for a, b in pairwise(momenta)]
    return Peaks(
        max(max(abs(torque) for torque in one.torques[:2]) for one in drive.seen),
        max(forces),
        drive.plant.swivel,
        drive.seen[-1].chassis,
    )


def test_peaks_of_torque_and_force_with_and_without_compensation_m11_m14() -> None:
    """Set B. Directly 12.20 N m and 225.1 N, compensated 4.95 and 95.12; here 12.79, 233.9, 5.29, 104.0 (+4 to +9 %).

    What is more is the speed loops': where the acceleration steps they overshoot, and a ramp is met in steps of 1 ms.
    """
    free, held = peaks(None), peaks(2.0)
    assert free.torque == pytest.approx(12.20, rel=0.10)
    assert free.force == pytest.approx(225.1, rel=0.08)
    assert held.torque == pytest.approx(4.95, rel=0.14)
    assert held.force == pytest.approx(95.12, rel=0.19)
    assert free.torque / held.torque >= 2.0  # M14; measured 2.42, the paper 2.37


def test_friction_and_rotors_of_the_robot_file_cost_both_alike_m14() -> None:
    """moby as its file has it: 17.9 and 8.5 N m. Drag and rotors add 3 N m to both, so the ratio is 2.1."""
    assert peaks(None, own=True).torque / peaks(2.0, own=True).torque >= 2.0


def test_the_caster_ends_behind_its_joint_pushed_and_pulled_m10() -> None:
    """Uncompensated the chassis has flipped, and is pushed."""
    free, held = peaks(None), peaks(2.0)
    assert remainder(free.heading, tau) == pytest.approx(0.0, abs=1e-3)
    assert remainder(free.swivel - PUSHED, tau) == pytest.approx(0.0, abs=1e-3)
    assert remainder(held.heading - pi, tau) == pytest.approx(0.0, abs=1e-3)
    assert remainder(held.swivel - PULLED, tau) == pytest.approx(0.0, abs=1e-3)


# -- arcs -------------------------------------------------------------------------------------------------------------

D1 = 0.145  # m, of the real robot


def along_figure_9(gain: float | None, *, seconds: float = 60.0) -> tuple[list[float], list[float]]:
    """Errors of gamma, degrees, and of the place, m, at 0.5 m/s after a ramp of 1 s; nobody corrects the way."""
    path, drive, s, t = figure_9(), Drive(heading=asin(0.2 * D1) - pi, offset=D1, gain=gain, own=True), 0.0, 0.0
    errors, deviations = [], []
    while s < path.length and t < seconds:
        speed, point = 0.5 * min(1.0, t), path.at(s)
        drive.cycle(speed * cos(point.heading), speed * sin(point.heading), path_rate=speed * point.curvature)
        s, t = s + speed * 0.004, t + 0.004
        one, due = drive.seen[-1], path.at(min(s, path.length))
        deviations.append(hypot(one.pose.x - due.x, one.pose.y - due.y))
        vx, vy = one.velocity
        if hypot(vx, vy) > 0.05:
            gamma = atan2(vy, vx) - one.chassis
            errors.append(abs(degrees(remainder(gamma - pi + asin(D1 * due.curvature), tau))))
    assert drive.alarms == []
    return errors, deviations


def test_arcs_are_driven_pulled_m15() -> None:
    """gamma within 0.5 degrees, as asked; 0.29 measured. 17 mm off the way (kinematic 7.6).

    At 1 kHz 6.3 mm, at 50 Hz 135: a command needs some cycles through loop and bus, and the joint angle is a cycle old.
    """
    errors, deviations = along_figure_9(2.0)
    assert max(errors) <= 0.5
    assert max(deviations) <= 0.035


def test_without_compensation_the_chassis_flips_on_arcs_m16() -> None:
    errors, _ = along_figure_9(None, seconds=8.0)
    assert max(errors) > 170.0


# -- impacts ----------------------------------------------------------------------------------------------------------


def impact(*, gain: float | None, torque: float, rate: float, force: float = 4000.0) -> Drive:
    """25 ms across the chassis at the caster's joint, pulled at 1.2 m/s; 2.5 s on the way there."""
    drive = Drive(heading=pi, rate=rate, gain=gain, torque=torque)
    for cycle in range(round(6.0 * rate)):
        t = cycle / rate
        drive.plant.set_force(Point.CASTER_JOINT, 0.0, force if 2.4995 < t < 2.5245 else 0.0)
        drive.cycle(1.2 * min(1.0, t / 1.5), 0.0)
    return drive


@pytest.mark.parametrize(("rate", "largest", "settled"), [(1000.0, 42.6, 0.791), (250.0, 52.5, 0.928)])
def test_compensation_recovers_from_an_impact_m17(rate: float, largest: float, settled: float) -> None:
    """Asked for 53 degrees (8 more or less) and below 5 within 1 s, for motors that are led ideally: met, or better.

    The platform is turned too, by 34 and 44 degrees: nothing holds its heading. Motors are at their limits meanwhile.
    """
    drive = impact(gain=2.0, torque=75.5, rate=rate)
    hit = [one for one in drive.seen if one.t > 2.4]
    off = [abs(degrees(remainder(one.chassis - pi, tau))) for one in hit]
    assert max(off) == pytest.approx(largest, rel=0.15)
    assert max(off) < 61.0
    late = max(one.t - 2.5 for one, error in zip(hit, off, strict=True) if error > 5.0)
    assert late == pytest.approx(settled, rel=0.1)
    assert late < 1.0
    assert off[-1] < 0.4  # at 250 Hz 0.17, as long as it drives: the joint angle is a cycle old
    assert drive.alarms == []
    clipped = [max(abs(one.torques[joint]) for one in hit) for joint in range(3)]
    assert clipped == pytest.approx([75.5, 75.5, 150.0]), "what the controllers may give, and no more"


def test_without_compensation_it_flips_in_an_impact_m17() -> None:
    drive = impact(gain=None, torque=75.5, rate=250.0)
    assert abs(drive.off(5.9)) > 179.0


def test_weak_motors_lose_it_in_an_impact_and_that_is_an_alarm_m17() -> None:
    """20 N m: a wheel is turned against its setpoint, which is told within 0.1 s, and the robot stops for it."""
    drive = impact(gain=2.0, torque=20.0, rate=250.0)
    assert abs(drive.off(5.9)) > 90.0
    alarms = {code: t for t, code in reversed(drive.alarms)}
    assert 2.5 < alarms["fault_runaway"] < 2.6
    assert drive.engine.mode is Mode.FAULT


@pytest.mark.parametrize(("torque", "force"), [(20.0, 2000.0), (30.0, 3000.0)])
def test_a_flip_in_spite_of_compensation_is_told_m17(torque: float, force: float) -> None:
    """Where the motors were led far from what they were told, and no fault was seen in that."""
    drive = impact(gain=2.0, torque=torque, rate=250.0, force=force)
    assert abs(drive.off(5.9)) > 170.0
    ((t, code),) = drive.alarms
    assert code == "pull_lost"
    assert 2.5 < t < 3.5


def test_a_reversal_is_no_flip() -> None:
    """From pulled to pushed and back, by the command: nothing was lost."""
    drive = Drive(heading=pi, gain=2.0, own=True)
    for speed in (0.5, -0.5, 0.5):
        for cycle in range(375):
            drive.cycle(speed * min(1.0, cycle / 100.0, (375 - cycle) / 100.0), 0.0)
    assert drive.off(4.4) == pytest.approx(0.0, abs=1.0)
    assert drive.alarms == []


# -- slippery ground --------------------------------------------------------------------------------------------------


def test_on_ice_it_gains_no_more_speed_than_its_load_on_the_wheels_gives() -> None:
    """mu = 0.05 under the wheels, and 1 m/s asked for at once: 131.09 kg, of which 61 % are on the axle."""
    drive = Drive(heading=0.0, swivel=PUSHED, own=True)
    for wheel in drive.plant.wheels:
        drive.plant.set_friction(wheel, 0.05)
    most = 0.05 * sum(drive.plant.loads)
    for _ in range(125):
        drive.cycle(1.0, 0.0)
    speed = drive.seen[-1].velocity[0]
    assert drive.plant.slipping == (0, 1)
    assert drive.seen[-1].momentum[0] <= most * 0.5
    assert speed == pytest.approx(most * 0.5 / 131.09, rel=0.05)
    given = [sum(t * r for t, r in zip(one.torques, one.rates, strict=True)) * 0.004 for one in drive.seen]
    assert 0.0 < drive.plant.energy < sum(given)


# -- section 8 --------------------------------------------------------------------------------------------------------


def hits(gain: float, hit: float, seconds: float) -> list[float]:
    """Headings, degrees, per cycle: back at 0.05 m/s, 0.5 m/s across from 10 s and, reversed, from 22 s.

    A hit is a command, and compensation would turn it to the other side: it is off in a hit, where the kinematic
    reference goes on correcting.
    """
    drive, now = Drive(heading=0.0, offset=D1, gain=2.0, own=True), 2.0
    for cycle in range(round(seconds * 250.0)):
        t = cycle * 0.004
        across = next((v for start, v in ((10.0, 0.5), (22.0, -0.5)) if start - 1e-9 <= t < start + hit - 1e-9), 0.0)
        wanted = 0.0 if across else gain
        drive.cycle(-0.05, across, settings=None if wanted == now else {"compensation_gain": wanted})
        now = wanted
    return [degrees(one.chassis) for one in drive.seen]


@pytest.mark.parametrize(
    ("gain", "hit", "figures"),
    [
        (0.0, 0.4, {10.4: (64.8, 63.2), 15.0: (144.3, 144.9), 22.0: (176.7, 176.8)}),
        (
            2.0,
            0.8,
            {10.8: (77.8, 87.3), 15.0: (21.5, 26.1), 22.0: (1.94, 2.38), 22.8: (-77.6, -86.9), 30.0: (-7.7, -9.35)},
        ),
    ],
    ids=["M18", "M19"],
)
def test_hits_turn_the_chassis_as_in_section_8(
    gain: float, hit: float, figures: dict[float, tuple[float, float]]
) -> None:
    """Degrees: the kinematic reference, and what was measured here. M19 has ten more, as nothing corrects in a hit."""
    headings = hits(gain, hit, 30.0 if gain else 22.0)
    side = 1.0 if headings[round(10.3 / 0.004)] > 0.0 else -1.0
    for t, (reference, measured) in figures.items():
        found = side * headings[round(t / 0.004) - 1]
        assert found == pytest.approx(measured, rel=0.05)
        assert found == pytest.approx(reference, rel=0.5 if gain else 0.05)
