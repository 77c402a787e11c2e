"""The no-slip launch: on a floor that gives so much and no more, in eight directions, and by what each motor can."""

from collections.abc import Sequence
from math import cos, hypot, pi, sin, sqrt

import pytest

from drivers.setpoint import CommandKind
from gateway.chassis.omni import OmniRobot
from gateway.config import ConfigError, parse
from gateway.control.decoupled import Decoupled, Saturation
from gateway.control.drive_law import JointCommand, Measured, SpeedLaw
from gateway.control.grip import Grip, part_of
from gateway.control.launch import MARGIN, LaunchLaw, Pusher
from gateway.control.launch_slip import Losses
from gateway.control.limits import TwistLimiter, turning_excess
from gateway.control.transmission import Winding
from gateway.control.wheel_limits import WheelLimits
from gateway.core.assembly import build
from gateway.core.examination import examine
from gateway.types import ZERO_TWIST, Event, Twist
from tests.world import World, robot_text

MASS, RADIUS = 25.0, 0.0762  # kg, m
DT = 0.004


def gripping(text: str, friction: float = 0.8) -> str:
    return text.replace("[loop]", f"[robot.grip]\nfriction = {friction}\n\n[loop]", 1)


def test_without_its_section_nothing_is_new() -> None:
    assert type(build(parse(robot_text("omni4"), "omni4")).law) is SpeedLaw


@pytest.mark.parametrize("friction", ["0.01", "3.0", '"high"'])
def test_friction_has_a_range(friction: str) -> None:
    with pytest.raises(ConfigError, match=r"grip\.friction"):
        parse(gripping(robot_text("omni4"), 0.5).replace("friction = 0.5", f"friction = {friction}"), "omni4")


def test_a_centre_outside_the_wheels_is_a_bad_robot_file() -> None:
    text = gripping(robot_text("omni4"))
    for x in ("0.10", "-0.10"):
        text = text.replace(f"x = {x}\n", f"x = {float(x) + 0.3}\n")
    with pytest.raises(ConfigError, match=r"robot\.grip: wheel \d carries -"):
        build(parse(text, "omni4"))


def test_check_says_how_long_a_commanded_stop_takes() -> None:
    """Driven: never longer, and not half as long where it is longest."""
    grip = examine(parse(gripping(robot_text("omni4"), 0.2), "omni4"), "omni4").grip
    assert grip is not None
    taken = []
    for eighth in (0, 1, 2):
        world = World("omni4", edit=lambda text: gripping(text, 0.2))
        world.start()
        x, y = 2.0 * cos(eighth * pi / 4), 1.5 * sin(eighth * pi / 4)
        for _ in range(600):
            world.cycle(commands=[world.command(Twist(x, y, 0.0))])
        cycles = 0
        while any(world.last.trace.setpoint):
            world.cycle(commands=[world.command(ZERO_TWIST)])
            cycles += 1
        taken.append(cycles * DT)
    assert 0.45 * grip.stopping_time_s < max(taken) <= grip.stopping_time_s


def test_a_floor_on_which_a_commanded_stop_takes_too_long_is_refused() -> None:
    words = r"robot\.grip\.friction = 0\.05: a commanded stop from top speed takes .* s and .* m; allowed up to 5 s"
    with pytest.raises(ConfigError, match=words):
        examine(parse(gripping(robot_text("omni4"), 0.05), "omni4"), "omni4")


# the law alone

LIMITS = (9.0, 9.0, 30.0)


def launch_law(
    pusher: Pusher,
    *,
    friction: float = 0.6,
    height: float = 0.1,
    inertia: float = 0.0,
    losses: tuple[float, float] = (0.0, 0.0),
) -> LaunchLaw:
    """`losses`: N m s/rad and N m of each wheel."""
    robot = parse(robot_text("omni4"), "omni4").robot
    assert isinstance(robot, OmniRobot)
    kinematics = robot.kinematics()
    speeds = SpeedLaw(kinematics, top_speeds=[45.0] * 4, velocity=(2.0, 1.5, 4.0), period=DT)
    places = [(wheel.x, wheel.y) for wheel in robot.wheel]
    return LaunchLaw(
        speeds,
        grip=Grip(kinematics.rim_matrix, places, mass=MASS, inertia=0.9, height=height),
        friction=friction,
        radii=[RADIUS] * 4,
        losses=Losses(inertia, *losses),
        acceleration=LIMITS,
        top_speeds=[45.0] * 4,
        pushers=[pusher] * 4,
    )


def measured(speeds: Sequence[float | None], torques: Sequence[float | None] = (None,) * 4) -> Measured:
    here = Measured(0, DT, tuple(speeds), (0.0,) * 4, tuple(torques), (0,) * 4, (0.0,) * 4)
    return here._replace(torque_ages_ns=(0,) * 4)


def ramp(law: LaunchLaw, rate: float, cycles: int, *, braking: bool = False) -> list[tuple[JointCommand, ...]]:
    """Forward at this acceleration, with wheels that turn as told."""
    found = []
    for cycle in range(cycles + 1):
        setpoint = (rate * DT * cycle, 0.0, 0.0)
        law.ground(whole=True)
        turning = [rate * DT * max(cycle - 1, 0) * part / RADIUS for part in (-sqrt(0.75), -sqrt(0.75), sqrt(0.75))]
        now = measured([turning[0], turning[1], turning[2], turning[2]])
        found.append(law.motion(setpoint, now, braking=braking).commands)
    return found


def test_torque_is_shared_by_load() -> None:
    """Forward at 4 m/s^2 the rear wheels carry 86.3 N and the front ones 36.3 N; together they push 100 N."""
    front, rear = ramp(launch_law(Pusher(True, True, hosted=False, torque=4.5)), 4.0, 3)[-1][:2]
    assert front.feed_forward / rear.feed_forward == pytest.approx(-29.46 / -93.16, abs=0.002)  # as loads at the limit
    assert -2.0 * sqrt(0.75) * (front.feed_forward + rear.feed_forward) / RADIUS == pytest.approx(100.0)
    assert front.limit == pytest.approx(0.6 * RADIUS * 36.31, abs=1e-3)
    assert rear.limit == pytest.approx(0.6 * RADIUS * 86.31, abs=1e-3)


def test_a_wheel_may_push_by_the_least_that_it_has_carried_lately() -> None:
    """The robot follows its setpoint a little later, and with it the load: in the first cycle it is that of rest."""
    front, rear = ramp(launch_law(Pusher(True, True, hosted=False, torque=4.5)), 4.0, 1)[-1][:2]
    assert rear.limit == pytest.approx(0.6 * RADIUS * MASS * 9.81 / 4.0, abs=1e-3)
    assert front.limit == pytest.approx(0.6 * RADIUS * 36.31, abs=1e-3)


def test_what_holds_wheels_back_after_a_launch_follows_a_friction_that_is_set() -> None:
    """All of them together are pressed by the whole robot, and so they are once the launch is over."""
    law = launch_law(Pusher(True, True, hosted=False, torque=10.0), friction=0.6)
    ramp(law, 3.0, 5)
    steady, pushing = (3.0 * DT * 5, 0.0, 0.0), measured([0.0] * 4, [50.0] * 4)
    for friction in (0.6, 0.9, 0.3):
        law.set("friction", friction)
        for _ in range(3):
            commands = law.motion(steady, pushing, braking=False).commands
            together = sum(command.limit or 0.0 for command in commands)
        assert together == pytest.approx(friction * RADIUS * MASS * 9.81, rel=1e-3)


def slipping(*, wz: float = 0.0, braked: bool = False) -> list[str]:
    """Events of wheels that turn as told while the floor pushes back by nothing."""
    law = launch_law(Pusher(True, True, hosted=False, torque=4.5), inertia=0.004)
    found: list[Event] = []
    rate = -4.0 if braked else 4.0
    for cycle in range(30):
        setpoint = (1.0 + rate * DT * cycle, 0.0, wz)
        turning = law._speeds.speeds_at(setpoint, (), braking=False)[0]
        law.ground(whole=True)
        torques = [0.2 + 0.001 * cycle] * 4
        found += law.motion(setpoint, measured(turning, torques), braking=False).events
    return [event.code for event in found]


def test_slip_is_looked_for_while_it_speeds_up_straight_on() -> None:
    assert slipping() == ["launch_slipped"]
    assert slipping(braked=True) == [], "what resists a wheel that brakes is not known as well"
    assert slipping(wz=0.5) == [], "in a curve the shares change all the time"


@pytest.mark.parametrize("ended", ["braking", "forgotten"])
def test_torque_is_held_after_a_launch_until_it_brakes_or_all_is_forgotten(ended: str) -> None:
    law = launch_law(Pusher(True, True, hosted=False, torque=10.0))
    ramp(law, 3.0, 5)
    steady, pushing = (3.0 * DT * 5, 0.0, 0.0), measured([0.0] * 4, [50.0] * 4)
    assert None not in [one.limit for one in law.motion(steady, pushing, braking=False).commands]
    if ended == "forgotten":
        law.forget_told()
    for braking in (ended == "braking", False):
        assert {one.limit for one in law.motion(steady, pushing, braking=braking).commands} == {None}


TOLD = Pusher(True, True, hosted=False, torque=4.5)


def pushes(law: LaunchLaw, setpoints: Sequence[Twist]) -> list[float]:
    """The largest torque that a wheel is told besides its speed, at each of these."""
    found = []
    for setpoint in setpoints:
        law.ground(whole=True)
        turning = law._speeds.speeds_at(setpoint, (), braking=False)[0]
        commands = law.motion(setpoint, measured(turning), braking=False).commands
        found.append(max(abs(one.feed_forward) for one in commands))
    return found


def test_a_setpoint_that_jumps_was_put_elsewhere_and_is_no_push() -> None:
    limit, step = LIMITS[0] * DT, [Twist(0.5, 0.0, 0.0)]
    assert pushes(launch_law(TOLD), [*step, Twist(0.5 + 1.1 * limit, 0.0, 0.0)])[-1] > 0.0
    assert pushes(launch_law(TOLD), [*step, Twist(0.5 + 1.3 * limit, 0.0, 0.0)])[-1] == 0.0


def test_what_the_wheels_cannot_turn_is_no_push() -> None:
    """Beyond their top speed the setpoint grows and they do not."""
    top = 45.0 * RADIUS / sqrt(0.75)
    below, beyond = ([Twist(part * top + 0.016 * n, 0.0, 0.0) for n in range(3)] for part in (0.9, 1.1))
    assert pushes(launch_law(TOLD), below)[-1] > 0.0
    assert pushes(launch_law(TOLD), beyond)[-1] == pytest.approx(0.0, abs=1e-9)


def test_the_effort_is_never_more_than_the_limits() -> None:
    law, still = launch_law(TOLD, friction=2.0, height=0.0), (0.0, 0.0, 0.0)
    assert law.effort(still, LIMITS, still) < 1.0
    slow = (2.0, 0.0, 0.0)
    assert law.effort(still, slow, still) == 1.0
    assert law.effort((0.0, 0.0, 0.1), slow, still) == 1.0, "in a curve too"


def test_no_wheel_is_to_leave_the_floor() -> None:
    """A high robot on a floor that grips well, sped up askew: the wheel ahead carries nothing from there on."""
    law = launch_law(TOLD, friction=2.0, height=0.5)
    grip, (x, y) = law._grip, (cos(pi / 4), sin(pi / 4))
    shifts = [x * along + y * across for along, across in grip.shifts]
    lifting = min(rest / -shift for rest, shift in zip(grip.resting, shifts, strict=True) if shift < 0.0)
    way = (LIMITS[0], LIMITS[1], 0.0)  # as far as the limits go
    assert lifting < 0.8 / part_of([cone.limit for cone in grip.cones(2.0)], (x, y, 0.0)), "friction alone gives more"
    for rates in ((0.0, 0.0, 0.0), (0.0, 0.0, 1e-9)):
        assert law.effort(rates, way, (0.0, 0.0, 0.0)) == pytest.approx(MARGIN * lifting / hypot(*way))


def test_a_wheel_may_have_what_does_not_reach_the_floor_besides() -> None:
    friction, drag, speed = 0.02, 0.15, 4.0 * DT * 3 * sqrt(0.75) / RADIUS
    plain, lossy = (ramp(launch_law(TOLD, losses=losses), 4.0, 3)[-1] for losses in ((0.0, 0.0), (friction, drag)))
    for one, other in zip(plain, lossy, strict=True):
        assert one.limit is not None
        assert other.limit is not None
        assert other.limit - one.limit == pytest.approx(friction * speed + drag)


def slip_once(law: LaunchLaw) -> list[Event]:
    """A launch on which the floor pushes back by next to nothing."""
    found: list[Event] = []
    law.forget_told()
    for cycle in range(60):
        setpoint = (1.0 + 4.0 * DT * cycle, 0.0, 0.0)
        turning = law._speeds.speeds_at(setpoint, (), braking=False)[0]
        law.ground(whole=True)
        found += law.motion(setpoint, measured(turning, [0.05 + 0.001 * cycle] * 4), braking=False).events
    return found


def test_no_slip_teaches_less_than_a_quarter_of_the_friction_that_was_given() -> None:
    law = launch_law(TOLD, inertia=0.004)
    for given in (0.6, 0.8, 0.4):
        law.set("friction", given)
        learned = [law.friction]
        for _ in range(40):
            slip_once(law)
            learned.append(law.friction)
        assert learned[0] == given
        assert min(learned) == learned[-1] == pytest.approx(0.25 * given)
        assert not slip_once(law), "there is nothing left to learn"


@pytest.mark.parametrize(("torque", "dead"), [(4.5, True), (1.2, False)])
def test_a_wheel_that_has_caught_up_is_held_back_no_longer(torque: float, dead: bool) -> None:
    """After a launch: one that still takes nearly all that it may is, one that takes less is not."""
    law = launch_law(TOLD)
    ramp(law, 3.0, 5)
    steady = (3.0 * DT * 5, 0.0, 0.0)
    limits = []
    for _ in range(3):
        law.ground(whole=True)
        limits.append(law.motion(steady, measured([0.0] * 4, [torque] * 4), braking=False).commands[0].limit)
    assert (limits[-1] is not None) is dead


HOSTED = Pusher(True, True, hosted=True, torque=4.5)


def test_a_setpoint_that_was_put_elsewhere_is_told_to_speed_loops_on_the_host_at_once() -> None:
    """As when a bus is back, in a curve: from how the wheels turn, and not for one more cycle from before."""
    law = launch_law(HOSTED)
    for setpoint, put in (((1.0, 0.0, 2.0), False), ((0.5, 0.0, 1.0), True), ((0.5, 0.0, 1.0), False)):
        turning = law._speeds.speeds_at(setpoint, (), braking=True)[0]
        if put:
            law.forget_told()
        law.ground(whole=True)
        told = law.motion(setpoint, measured(turning), braking=True).commands
    assert [one.value for one in told] == pytest.approx(turning)
    law.forget_told()
    told = law.motion((0.2, 0.0, 0.4), measured(turning), braking=True).commands
    assert [one.value for one in told] == pytest.approx([0.4 * speed for speed in turning])


def test_after_slip_speed_loops_on_the_host_go_on_from_how_the_wheels_turn() -> None:
    law, friction = launch_law(HOSTED, inertia=0.004), 0.6
    for cycle in range(30):
        setpoint = (1.0 + 4.0 * DT * cycle, 0.0, 0.0)
        speeds = law._speeds.speeds_at(setpoint, (), braking=False)[0]
        law.ground(whole=True)
        turning = [0.992 * speed for speed in speeds]
        motion = law.motion(setpoint, measured(turning, [0.2 + 0.001 * cycle] * 4), braking=False)
        if motion.events:
            break
    assert law.friction < friction
    assert motion.share == pytest.approx(0.992)
    assert [one.value for one in motion.commands] == pytest.approx(turning)


def test_a_stop_is_not_limited_and_pushes_no_more_than_the_floor_gives() -> None:
    commands = ramp(launch_law(Pusher(True, True, hosted=False, torque=4.5)), 8.0, 3, braking=True)[-1]
    assert {command.limit for command in commands} == {None}
    assert sum(abs(command.feed_forward) for command in commands) == pytest.approx(0.6 * RADIUS * MASS * 9.81)


def test_a_motor_that_takes_only_a_speed_gets_the_ramp() -> None:
    for limit in (False, True):
        commands = ramp(launch_law(Pusher(False, limit, hosted=False, torque=4.5)), 4.0, 3)[-1]
        assert {command.kind for command in commands} == {CommandKind.VELOCITY}
        assert {command.feed_forward for command in commands} == {0.0}
        assert all((command.limit is not None) == limit for command in commands)
        assert commands[2].value == pytest.approx(4.0 * 3 * DT * sqrt(0.75) / RADIUS)


def test_a_robot_that_is_not_whole_is_not_pushed() -> None:
    law = launch_law(Pusher(True, True, hosted=False, torque=4.5))
    for cycle in range(3):
        setpoint = (0.016 * cycle, 0.0, 0.0)
        law.ground(whole=False)
        commands = law.motion(setpoint, measured([0.0] * 4), braking=False).commands
    assert {(command.feed_forward, command.limit) for command in commands} == {(0.0, None)}


KEPT = {Saturation.BOTH: (), Saturation.TRANSLATION: (0, 1), Saturation.ROTATION: (2,)}  # axes that are never cut


def on_course(saturation: Saturation) -> TwistLimiter:
    robot = parse(robot_text("omni4"), "omni4").robot
    wheels = WheelLimits(robot.kinematics().matrix(), speeds=[45.0] * 4)
    velocity, jerk, course = (2.0, 1.5, 4.0), (150.0, 150.0, 400.0), None
    if saturation is not Saturation.BOTH:
        course = Decoupled(saturation, velocity=velocity, acceleration=LIMITS, jerk=jerk, wheels=wheels)
    return TwistLimiter(velocity=velocity, acceleration=LIMITS, jerk=jerk, course=course)


@pytest.mark.parametrize("saturation", Saturation)
def test_what_the_setpoint_asks_of_the_floor_it_gives(saturation: Saturation) -> None:
    """Through the limiter, in curves too: dv/dt + w x v stays within the polytope of the floor, but for its steps."""
    law = launch_law(Pusher(True, True, hosted=False, torque=4.5), friction=0.4)
    limits = [*[cone.limit for cone in law._grip.cones(0.4)], *law._grip.lifting()]
    moving, worst = on_course(saturation), 0.0
    for target in ((1.5, 0.5, 0.0), (0.5, 0.0, 3.0), (-0.5, 1.0, -1.0), (1.5, 1.0, 2.0), (0.0, 0.0, 0.0)):
        for _ in range(400):
            before = moving.rates
            moving.step(target, DT, ground=law.ground(whole=True))
            mean = [0.5 * (a + b) for a, b in zip(before, moving.rates, strict=True)]
            ax, ay, az = [(b - a) / DT for a, b in zip(before, moving.rates, strict=True)]
            worst = max(worst, part_of(limits, (ax - mean[2] * mean[1], ay + mean[2] * mean[0], az)))
        turning = max(law.turning(target), turning_excess(target, LIMITS))
        assert law.turning(moving.rates) == pytest.approx(min(turning, 1.0), abs=1e-6)
        cut = [1.0 / sqrt(max(1.0, turning))] * 3 if saturation is Saturation.BOTH else [1.0 / max(1.0, turning)] * 3
        for axis in KEPT[saturation]:
            cut[axis] = 1.0
        assert moving.rates == pytest.approx([a * b for a, b in zip(target, cut, strict=True)], abs=1e-6)
    assert worst < 1.1


@pytest.mark.parametrize("saturation", [Saturation.TRANSLATION, Saturation.ROTATION])
def test_what_is_first_is_launched_as_hard_as_it_would_be_alone(saturation: Saturation) -> None:
    first = KEPT[saturation]
    alone, beside = on_course(saturation), on_course(saturation)
    law = launch_law(Pusher(True, True, hosted=False, torque=4.5), friction=0.4)
    whole = (1.0, 0.4, 1.5)
    part = tuple(axis if index in first else 0.0 for index, axis in enumerate(whole))
    for _ in range(60):
        alone.step(part, DT, ground=law.ground(whole=True))
        beside.step(whole, DT, ground=law.ground(whole=True))
        for axis in first:
            assert abs(beside.rates[axis]) >= 0.9 * abs(alone.rates[axis])


# by voltage

WINDING = Winding(resistance=0.45, back_emf=0.3)
STEPPED = Pusher(False, False, hosted=False, torque=4.5, winding=WINDING, supply=24.0)


class Motors:
    """Four DC motors under a quarter of the robot each, driven by voltage or exactly at their speed."""

    def __init__(self, weight: float = 1.0) -> None:
        self.speeds = [0.0] * 4
        self.inertia = weight * MASS * RADIUS * RADIUS / 4.0 / 0.75  # forward, four wheels at 30 degrees

    def obey(self, commands: Sequence[JointCommand]) -> None:
        for index, command in enumerate(commands):
            if command.kind is CommandKind.VOLTAGE:
                torque = (command.value - WINDING.back_emf * self.speeds[index]) / WINDING.volts_per_torque
                self.speeds[index] += DT * torque / self.inertia
            else:
                self.speeds[index] = command.value


@pytest.mark.parametrize("hosted", [False, True])
def test_voltage_steps_until_the_ramp_ends_then_a_speed_without_a_step(hosted: bool) -> None:
    law, motors, speed, kinds, steps = (
        launch_law(STEPPED._replace(hosted=hosted), height=0.0),
        Motors(1.1),
        0.0,
        [],
        [],
    )
    for cycle in range(150):
        speed += 4.0 * DT if 1 <= cycle < 80 else 0.0
        law.ground(whole=True)
        motion = law.motion((speed, 0.0, 0.0), measured(motors.speeds), braking=False)
        speed *= motion.share
        before = list(motors.speeds)
        motors.obey(motion.commands)
        kinds.append(motion.commands[0].kind)
        steps.append(max(abs(a - b) for a, b in zip(before, motors.speeds, strict=True)))
    assert kinds[1:80] == [CommandKind.VOLTAGE] * 79
    assert kinds[80:] == [CommandKind.VELOCITY] * 70
    assert max(steps[80:]) < 0.05  # rad/s: the robot is a tenth heavier than told, so its wheels were behind
    assert speed == pytest.approx(79 * 4.0 * DT / 1.1, rel=0.1)


def test_it_brakes_by_voltage_steps_the_same_way() -> None:
    """A commanded stop: V below the back-EMF by that of the torque, until it stands; no wheel turns back."""
    law, motors, kinds = launch_law(STEPPED, height=0.0), Motors(), []
    for cycle in range(200):
        speed = 4.0 * DT * min(cycle, 80, max(0, 180 - cycle))
        law.ground(whole=True)
        motion = law.motion((speed, 0.0, 0.0), measured(motors.speeds), braking=False)
        kinds.append(motion.commands[2].kind)
        if 110 < cycle < 170:
            below = WINDING.back_emf * motors.speeds[2] - motion.commands[2].value
            torque = 4.0 * MASS * RADIUS / (4.0 * sqrt(0.75))
            assert below == pytest.approx(1.5 * torque, abs=1e-6)
        motors.obey(motion.commands)
    assert kinds[102:175] == [CommandKind.VOLTAGE] * 73
    assert kinds[185:] == [CommandKind.VELOCITY] * 15
    assert motors.speeds == pytest.approx([0.0] * 4, abs=1e-9)


def test_wheels_that_run_ahead_under_voltages_slip() -> None:
    """No torque is told and the wheels gain a third more than they should: the floor is taken for worse."""
    law, motors, events = launch_law(STEPPED, height=0.0), Motors(0.75), []
    speed = 0.0
    for _ in range(60):
        speed += 4.0 * DT
        law.ground(whole=True)
        motion = law.motion((speed, 0.0, 0.0), measured(motors.speeds), braking=False)
        speed *= motion.share
        motors.obey(motion.commands)
        events += [event.code for event in motion.events]
    assert events[0] == "launch_slipped"
    assert law.friction < 0.6


def test_wheels_that_do_not_follow_their_voltage_are_told_a_speed_until_rest() -> None:
    law, kinds = launch_law(STEPPED, height=0.0), []
    speed = 0.0
    for cycle in range(200):
        speed += 4.0 * DT if cycle >= 1 else 0.0
        law.ground(whole=True)
        motion = law.motion((speed, 0.0, 0.0), measured([0.0] * 4), braking=False)  # against a wall
        speed *= motion.share
        kinds.append(motion.commands[0].kind)
    assert CommandKind.VOLTAGE in kinds
    ended = len(kinds) - kinds[::-1].index(CommandKind.VOLTAGE)
    assert kinds[ended:] == [CommandKind.VELOCITY] * (200 - ended)
    assert ended < 80
