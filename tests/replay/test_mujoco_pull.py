"""moby pushed and pulled with MuJoCo beneath it, whose chassis flips and whose caster swivels by contacts alone.

Mostly through the whole path: command, engine, CAN, controller, MuJoCo. Figures by science 1.2 and 1.3, written out.
Bounds are about twice what was measured with MuJoCo 4.0.
"""

from collections.abc import Callable, Iterable
from math import asin, atan2, atanh, cos, degrees, hypot, log, pi, radians, remainder, sin, tan, tanh, tau
from random import Random
from typing import NamedTuple

import pytest

from gateway.chassis.offset_differential import OffsetDifferentialRobot
from gateway.config import parse
from gateway.types import ZERO_TWIST, Mode, Outputs, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.controllers.contract import STEP_S
from tests.replay.mujoco_plant import offset_differential
from tests.world import robot_text

TOP = 1.2  # m/s
D1, D3 = 0.25, 0.05  # m, of moby
STIFF = 300.0  # rad/s, of a speed loop that is nearly none
READY = 1.0  # s in which the robot gets ready to drive
UNCOMPENSATED = "# [robot.compensation]\n# gain = 2.0\n# region = 1.57"
COMPENSATED = "[robot.compensation]\ngain = 2.0\nregion = 1.57"


class Seen(NamedTuple):
    """The true robot after a cycle. `error`: of the direction of motion from that in which the chassis is pulled."""

    t: float  # s since the drive began
    outputs: Outputs | None  # None where MuJoCo is alone
    way: float  # m of the platform's joint
    speed: float  # m/s
    error: float  # rad
    swivel: float  # rad


class Drive:
    """moby on MuJoCo: its platform at heading zero at first, the chassis so that it points at `chassis`, rad."""

    def __init__(self, *, chassis: float, swivel: float, compensated: bool, rate_hz: float = 250.0) -> None:
        text = robot_text("moby", rate_hz=rate_hz)
        assert UNCOMPENSATED in text
        config = parse(text.replace(UNCOMPENSATED, COMPENSATED) if compensated else text, "moby")
        assert isinstance(config.robot, OffsetDifferentialRobot)
        self.plant = offset_differential(config.robot)
        self.loop = ClosedLoop(config, plant=self.plant, joint_angles={"platform": -chassis})
        self._every = max(1, round(rate_hz / 50.0))
        self._way = 0.0
        self.run(READY, ZERO_TWIST)
        assert self.loop.engine.mode is Mode.DRIVE
        self.plant.set_swivel(swivel)  # getting ready has swivelled it by some mrad

    def run(
        self,
        seconds: float,
        twist: Twist,
        *,
        push: Callable[[float], float] = lambda _: 0.0,
        until: Callable[[Seen], bool] = lambda _: False,
    ) -> list[Seen]:
        """So long, or until then; `push`: N along world x at a time."""
        period, found = self.loop.period_ns * 1e-9, list[Seen]()
        for index in range(round(seconds / period)):
            self.loop.bus.robot.set_push(push(index * period))
            command = TwistCommand("teleop", twist, TwistFrame.BODY, None, self.loop.next_ns)
            _, outputs = self.loop.cycle(commands=[command] if index % self._every == 0 else [])
            found.append(self._look(index * period, outputs))
            self._way += found[-1].speed * period
            if until(found[-1]):
                break
        return found

    def _look(self, t: float, outputs: Outputs) -> Seen:
        truth = self.loop.bus.robot.truth
        speed = hypot(truth.twist.vx, truth.twist.vy)
        course = truth.pose.theta + atan2(truth.twist.vy, truth.twist.vx)
        error = remainder(course - truth.chassis_angle - pi, tau)
        return Seen(t, outputs, self._way, speed, error, self.plant.swivel)


def crossing(drive: Iterable[Seen], error: float) -> tuple[float, float]:
    """Time and way at which the chassis is off by so much for the first time, between two cycles in proportion."""
    before = None
    for seen in drive:
        if before is not None and before.speed > 0.02 and abs(before.error) < error <= abs(seen.error):
            share = (error - abs(before.error)) / (abs(seen.error) - abs(before.error))
            return before.t + share * (seen.t - before.t), before.way + share * (seen.way - before.way)
        before = seen
    raise AssertionError(f"never off by {error} rad")


def led(c: float, *, chassis: float, swivel: float, seconds: float) -> list[Seen]:
    """MuJoCo alone, from speed c along x on: a stiff speed loop per joint lets nothing but the kinematics show.

    `way` is left out; the platform stays at heading zero.
    """
    robot = parse(robot_text("moby"), "moby").robot
    assert isinstance(robot, OffsetDifferentialRobot)
    plant, kinematics, found = offset_differential(robot), robot.kinematics(), list[Seen]()
    plant.place((0.0, 0.0, -chassis))
    plant.set_swivel(swivel)
    for index in range(round(seconds / STEP_S)):
        heading = plant.pose.theta
        wanted = kinematics.wheel_speeds(Twist(c * cos(heading), -c * sin(heading), 0.0), plant.angles)
        assert wanted is not None
        if index == 0:
            plant.set_motion((c, 0.0), wanted)
        loops = zip(plant.reflected_inertia, wanted, plant.rates, strict=True)
        plant.step([STIFF * inertia * (told - rate) for inertia, told, rate in loops])
        speed = hypot(plant.twist.vx, plant.twist.vy)
        course = plant.pose.theta + atan2(plant.twist.vy, plant.twist.vx)
        error = remainder(course - plant.chassis_angle - pi, tau)
        found.append(Seen((index + 1) * STEP_S, None, 0.0, speed, error, plant.swivel))
    return found


def swivelled(start: float, way: float) -> float:
    """By the corrected Eq. 6 with the chassis straight: beta after this way, forwards positive, rad.

    d3 d(beta)/ds = -cos(beta); science 1.2. The printed sign would have + cos(beta).
    """
    return asin(tanh(atanh(sin(start)) - way / D3))


@pytest.mark.parametrize("pulled", [False, True], ids=["pushed", "pulled"])
@pytest.mark.parametrize("start", [-1.3, 0.3, 1.3])
def test_the_caster_swivels_to_the_trailing_side_through_the_service_path(start: float, pulled: bool) -> None:
    """M10 by contacts: -90 degrees pushed, +90 pulled, and on the way there as the corrected row says.

    Within 15 mrad (measured). Compensated, as a caster that swings about would otherwise begin a flip.
    """
    sign = -1.0 if pulled else 1.0
    drive = Drive(chassis=0.0, swivel=start, compensated=pulled).run(3.0, Twist(0.5 * sign, 0.0, 0.0))
    for seen in drive:
        assert seen.swivel == pytest.approx(swivelled(start, sign * seen.way), abs=0.03)
    assert degrees(drive[-1].swivel) == pytest.approx(-90.0 * sign, abs=0.001)
    printed = swivelled(start, -sign * drive[-1].way)
    assert abs(drive[-1].swivel - printed) > 3.0, "the printed sign ends on the other side"


@pytest.mark.parametrize("c", [0.5, -0.5], ids=["pushed", "pulled"])
@pytest.mark.parametrize("start", [-1.3, 0.3, 1.3])
def test_the_first_rate_of_the_caster_is_that_of_the_corrected_row(start: float, c: float) -> None:
    """From a standing caster: after 20 ms of grip -(c/d3) cos(beta), 9.55 rad/s at 0.3. Measured within 3.4 %."""
    drive = led(c, chassis=0.0, swivel=start, seconds=0.022)
    rate = (drive[-1].swivel - drive[-3].swivel) / (2.0 * STEP_S)
    assert rate == pytest.approx(-c / D3 * cos(drive[-2].swivel), rel=0.07)


@pytest.mark.parametrize(("error", "seconds"), [(0.1, 1.467), (0.5, 1.132), (2.0, 0.843), (20.0, 0.362)])
def test_a_pulled_chassis_flips_in_the_time_that_the_law_says(error: float, seconds: float) -> None:
    """tan(gamma/2), 1.2 m/s, to 90 degrees; MuJoCo alone. Measured 1.468, 1.132, 0.842 and 0.359 s: within 0.8 %."""
    drive = led(TOP, chassis=pi - radians(error), swivel=pi / 2.0, seconds=1.6)
    assert crossing(drive, pi / 2.0)[0] == pytest.approx(seconds, rel=0.015)


def test_it_flips_in_that_time_at_top_speed_through_the_service_path() -> None:
    """Uncompensated, from 0.02 degrees at rest, which grow while it gets fast; within 10 % is asked.

    Measured 1.127, 0.839 and 0.359 s: within 0.7 %, of 4 ms loop, age of the feedback and lag of the controllers.
    """
    drive = Drive(chassis=pi - radians(0.02), swivel=pi / 2.0, compensated=False).run(5.0, Twist(TOP, 0.0, 0.0))
    end, _ = crossing(drive, pi / 2.0)
    for error, seconds in ((0.5, 1.132), (2.0, 0.843), (20.0, 0.362)):
        begin, _ = crossing(drive, radians(error))
        assert end - begin == pytest.approx(seconds, rel=0.014)
    assert {seen.outputs.mode for seen in drive if seen.outputs} == {Mode.DRIVE}


@pytest.mark.parametrize("error", [0.5, 2.0, 20.0])
def test_from_rest_it_flips_after_the_way_that_the_law_says(error: float) -> None:
    """d1 ln(1/tan(error/2)), whatever the speed: 1.359, 1.012, 0.434 m. Measured 1.379, 1.009, 0.428: within 1.5 %."""
    drive = Drive(chassis=pi - radians(error), swivel=pi / 2.0, compensated=False).run(4.0, Twist(TOP, 0.0, 0.0))
    way = D1 * log(1.0 / tan(radians(error) / 2.0))
    assert crossing(drive, pi / 2.0)[1] == pytest.approx(way, rel=0.03)


def pushes(seconds: float) -> Callable[[float], float]:
    """200 to 400 N for 0.1 s to either side, every 2 to 4 s; the same in every run."""
    chance, found, t = Random(8), list[tuple[float, float]](), 3.0
    while t < seconds:
        found.append((t, chance.choice((-1.0, 1.0)) * chance.uniform(200.0, 400.0)))
        t += chance.uniform(2.0, 4.0)
    return lambda now: next((force for begin, force in found if begin <= now < begin + 0.1), 0.0)


@pytest.mark.parametrize("rate_hz", [250.0, 50.0])
def test_compensation_holds_the_pull_region_for_a_minute_of_pushes(rate_hz: float) -> None:
    """At top speed, 4 and 20 ms. Measured: at most 5.5 degrees off, 0.003 before the next push; 1.13 to 1.21 m/s."""
    force = pushes(60.0)
    robot = Drive(chassis=-pi / 2.0, swivel=pi / 2.0, compensated=True, rate_hz=rate_hz)
    drive = [seen for seen in robot.run(60.0, Twist(0.0, TOP, 0.0), push=force) if seen.t > 2.5]
    assert 2.0 < max(degrees(abs(seen.error)) for seen in drive) < 11.0, "they are felt"
    recovered = [seen for seen in drive if not force(seen.t) and force(seen.t + 0.02)]
    assert len(recovered) > 15
    assert max(degrees(abs(seen.error)) for seen in recovered) < 0.01
    assert min(seen.speed for seen in drive) > 1.05
    assert max(seen.speed for seen in drive) < 1.25
    assert {seen.outputs.mode for seen in drive if seen.outputs} == {Mode.DRIVE}
    regions = {seen.outputs.status.chassis["region"] for seen in drive if seen.outputs and seen.outputs.status}
    assert regions == {"pull"}
    pose = robot.loop.bus.robot.truth.pose
    assert hypot(pose.x, pose.y) > 65.0, "a minute's way"


@pytest.mark.parametrize("rate_hz", [250.0, 50.0])
def test_without_it_the_same_pushes_flip_the_chassis(rate_hz: float) -> None:
    """Quiet until the first push, 5 s after it across; measured 4.2 and 3.9 s."""
    force = pushes(60.0)
    robot = Drive(chassis=-pi / 2.0, swivel=pi / 2.0, compensated=False, rate_hz=rate_hz)
    drive = robot.run(11.0, Twist(0.0, TOP, 0.0), push=force)
    assert max(degrees(abs(seen.error)) for seen in drive if 2.5 < seen.t < 3.0) < 0.1
    t, _ = crossing((seen for seen in drive if seen.t > 2.5), pi / 2.0)
    assert 3.0 < t < 8.0
    assert degrees(abs(drive[-1].error)) > 170.0, "and it stays pushed"
