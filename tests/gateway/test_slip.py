"""Slip: when it is told, which wheel it is, what becomes of the odometry and of the wheels, and never without cause."""

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from math import cos, degrees, hypot, inf, pi, sin, sqrt
from typing import NamedTuple

import pytest

from gateway.config import parse
from gateway.control.drive_law import Measured
from gateway.core.assembly import build
from gateway.core.health import Fault, FaultKind
from gateway.core.odometry import Spread
from gateway.core.sensors import Heading
from gateway.core.slip import NO_SLIP, Slip, SlipDetector, _only
from gateway.core.slip_model import SlipModel, slip_model
from gateway.kinematics.contract import Estimate
from gateway.types import Mode, Outputs, SensorSample, Twist
from tests.random_clean import clean_drive
from tests.world import NAMES, World, robot_text

DT = 0.004
R = 0.0762  # m, of the wheels of omni4
LEVER = 0.2  # m
HALF = 0.5  # sine of 30 degrees, the layout of omni4
COSINE = 0.8660254037844386
WHEELS = ("front_left", "rear_left", "rear_right", "front_right")
IMU = '\n[[sensor]]\nname = "imu"\nkind = "heading"\ntimeout = 0.1\n'
Twists = Callable[[float], Twist]


def ring(count: int) -> Callable[[str], str]:
    """Omni4 with so many wheels on the same circle."""

    def edit(text: str) -> str:
        head, rest = text[: text.index("[[robot.wheel]]")], text[text.index("[loop]") : text.index("[[motor]]")]
        motor = text[text.index("[[motor]]") : text.index("[[motor]]", text.index("[[motor]]") + 1)]
        names = [f"w{place}" for place in range(count)]
        before, _, after = rest.partition("motor_speed = {")
        rest = (
            before + "motor_speed = { " + ", ".join(f"{name} = 45.0" for name in names) + " }" + after.split("}", 1)[1]
        )
        wheels = motors = ""
        for place, name in enumerate(names):
            angle = 2.0 * pi * (place + 0.3) / count
            pose = f"x = {LEVER * cos(angle)}\ny = {LEVER * sin(angle)}\naxis_angle = {angle}\nradius = {R}\n"
            wheels += f'[[robot.wheel]]\nmotor = "{name}"\n{pose}\n'
            motors += motor.replace('"front_left"', f'"{name}"').replace("\nid = 1\n", f"\nid = {place + 1}\n")
        return head + wheels + rest + motors + text[text.index("[commands]") :]

    return edit


# -- on oil, in closed loop -------------------------------------------------------------------------------------------


class Oil(NamedTuple):
    """What came of a drive over oil: s until it was told, names that were given, and errors of the pose."""

    told_after: float
    named: set[tuple[str, ...]]
    metres: float
    turn: float  # degrees
    doubt: float  # degrees, one sigma of the heading by the covariance that is told
    way: float  # m really driven
    codes: list[str]


def over_oil(
    direction: float, wheel: int, *, friction: float = 0.05, world: World | None = None, gyro: bool = False
) -> Oil:
    """From rest to 1.2 m/s, where after 0.25 s one wheel has oil beneath it for 1.5 s."""
    world = world or World("omni4")
    world.start()
    robot, names = world.bus.robot, world.config.robot.motor_names()
    twist = Twist(1.2 * cos(direction), 1.2 * sin(direction), 0.0)

    def sensed(now_ns: int) -> Iterable[SensorSample]:
        return [SensorSample("imu", (robot.truth.pose.theta,), None, now_ns, "imu-1")] if gyro else []

    world.run(0.25, twist, sensed=sensed)
    begin, first = robot.truth.pose, world.last.trace.pose
    named: set[tuple[str, ...]] = set()
    told_after = inf
    robot.set_friction(names[wheel], friction)
    start_ns = world.now_ns

    def watch(outputs: Outputs) -> bool:
        nonlocal told_after
        for event in outputs.events:
            if event.code == "slip":
                told_after = min(told_after, (world.now_ns - start_ns) * 1e-9)
        if outputs.status is not None and outputs.status.slip is not None and outputs.status.slip.wheels:
            named.add(outputs.status.slip.wheels)
        return False

    world.run(1.5, twist, until=watch, sensed=sensed)
    robot.set_friction(names[wheel], inf)
    world.run(0.5, twist, until=watch, sensed=sensed)
    true, seen = robot.truth.pose, world.last.trace.pose
    error = hypot(seen.x - first.x - (true.x - begin.x), seen.y - first.y - (true.y - begin.y))
    turn = degrees(abs(seen.theta - first.theta - (true.theta - begin.theta)))
    odometry = next(outputs.odometry for _, outputs in reversed(world.records) if outputs.odometry is not None)
    doubt = degrees(sqrt(odometry.covariance[8]))
    return Oil(told_after, named, error, turn, doubt, hypot(true.x - begin.x, true.y - begin.y), world.codes())


@cache
def handled(eighth: int) -> Oil:
    return over_oil(eighth * pi / 4.0, eighth % 4)


def unaware() -> World:
    """A robot that knows of no slip."""
    world = World("omni4")
    world.engine._slip = None
    return world


@pytest.mark.parametrize("eighth", range(8))
def test_the_wheel_on_oil_is_found_and_the_odometry_goes_on_by_the_others(eighth: int) -> None:
    """Seen: told after 20 to 40 ms; 1 to 2 mm and 0.1 degrees off, without any of this 23 to 138 mm and 2 to 7."""
    found = handled(eighth)
    assert found.told_after <= 0.06
    assert found.named == {(WHEELS[eighth % 4],)}
    assert found.metres <= 0.006
    assert found.turn <= 0.3
    assert found.codes.count("slip_over") == 1
    assert not [code for code in found.codes if code.startswith("fault")]
    assert found.doubt <= 2.0, "by what the other wheels tell; by all of them it would be 3.3 degrees"
    assert found.way >= 2.0, "it drives on: where that wheel swings with all its torque it loses half of that"


def test_what_it_is_worth() -> None:
    with_it = [handled(eighth) for eighth in range(4)]
    without = [over_oil(eighth * pi / 4.0, eighth % 4, world=unaware()) for eighth in range(4)]
    assert max(one.metres for one in with_it) < 0.1 * max(one.metres for one in without)
    assert max(one.turn for one in with_it) < 0.1 * max(one.turn for one in without)
    assert sum(one.metres for one in with_it) < 0.1 * sum(one.metres for one in without)
    assert sum(one.way for one in with_it) > 1.5 * sum(one.way for one in without)


@pytest.mark.parametrize(
    "change", [lambda world: world.bus.robot.set_mass(35.0), lambda world: world.bus.robot.set_slope(0.09)]
)
@pytest.mark.parametrize("eighth", [0, 3, 6])
def test_a_wrong_mass_and_a_slope_mislead_nobody(eighth: int, change: Callable[[World], None]) -> None:
    world = World("omni4")
    change(world)
    found = over_oil(eighth * pi / 4.0, eighth % 4, world=world)
    assert found.named == {(WHEELS[eighth % 4],)}
    assert found.metres <= 0.010


@pytest.mark.parametrize("count", [5, 6])
def test_of_five_and_six_wheels_it_is_named_too(count: int) -> None:
    found = over_oil(0.4, 2, world=World("omni4", edit=ring(count)))
    assert found.named == {("w2",)}
    assert found.metres <= 0.006


def test_three_wheels_have_no_check() -> None:
    world = World("omni4", edit=ring(3))
    found = over_oil(0.4, 2, world=world)
    assert found.told_after == inf
    assert world.last.trace.residual is None
    status = next(o.status for _, o in reversed(world.records) if o.status is not None)
    assert status.slip is not None
    assert status.slip.tells == "nothing: any speeds of the 3 wheels that are measured fit some motion"


def test_with_a_gyro_as_well() -> None:
    found = over_oil(0.0, 1, world=World("omni4", edit=lambda text: text + IMU), gyro=True)
    assert found.named == {("rear_left",)}
    assert found.metres <= 0.006


def test_a_lost_motor_takes_no_check_along_while_its_encoder_tells() -> None:
    world = World("omni4")
    world.start()
    world.run(0.5, Twist(0.0, 0.8, 0.0))
    world.engine._health.latch(Fault(FaultKind.STALL, "front_left", "for this test", latched=True))
    world.run(1.0, Twist(0.0, 0.8, 0.0))
    assert world.is_in(Mode.DEGRADED)
    assert world.last.trace.wheel_setpoints[0] is None
    assert "slip" not in world.codes()
    assert world.last.trace.residual is not None
    world.bus.robot.set_friction("rear_right", 0.02)
    world.run(1.0, Twist(0.0, -0.8, 0.0))
    assert "slip" in world.codes()


def test_moby_has_nothing_to_hold_a_wheel_against() -> None:
    world = World("moby")
    world.start()
    assert world.engine._slip is None
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status is not None)
    assert status.slip is None


@pytest.mark.parametrize("name", NAMES)
def test_a_clean_drive_is_not_even_suspected(name: str) -> None:
    """20 s of random commands; `python -m tests.bench.slip` drives 30 minutes."""
    drive = clean_drive(name, seed=7, seconds=20.0)
    assert drive.told == 0
    assert drive.suspected == 0


# -- what is told, wheel by wheel -------------------------------------------------------------------------------------


def row(angle: float) -> tuple[float, float, float]:
    return (-sin(angle), cos(angle), LEVER)


ROWS = [row(angle * pi / 180.0) for angle in (60, 120, 240, 300)]


def rows_of_ring(count: int) -> list[tuple[float, float, float]]:
    return [row(2.0 * pi * (place + 0.3) / count) for place in range(count)]


def model(edit: Callable[[str], str] = str) -> SlipModel:
    config = parse(edit(robot_text("omni4")), "omni4")
    found = slip_model(config, build(config))
    assert found is not None
    return found


class Wheels:
    """Wheels at will before the detector: `slips` m/s at the rim on top of what the motion makes them do."""

    def __init__(self, count: int = 4) -> None:
        edit, self._rows = (str, ROWS) if count == 4 else (ring(count), rows_of_ring(count))
        self._kinematics = build(parse(edit(robot_text("omni4")), "omni4")).kinematics
        self._count = count
        self.detector = SlipDetector([f"w{place}" for place in range(count)], model(edit))
        self.slip = NO_SLIP

    def see(
        self,
        twist: Twist,
        slips: Sequence[float] | None = None,
        *,
        torques: Sequence[float | None] | None = None,
        heading: Heading | None = None,
        ages_ms: Sequence[float] | None = None,
        unheard: int | None = None,
        dt: float = DT,
    ) -> Slip:
        nobody: tuple[None, ...] = (None,) * self._count
        slips, ages_ms = slips or (0.0,) * self._count, ages_ms or (0.5,) * self._count
        rims = [a * twist.vx + b * twist.vy + c * twist.wz + s for (a, b, c), s in zip(self._rows, slips, strict=True)]
        speeds = tuple(None if place == unheard else rim / R for place, rim in enumerate(rims))
        ages = tuple(round(age * 1e6) for age in ages_ms)
        measured = Measured(0, dt, speeds, nobody, nobody if torques is None else tuple(torques), ages, nobody)
        estimate: Estimate | None = self._kinematics.twist(speeds, ())
        self.slip = self.detector.look(measured, speeds, estimate, heading)
        return self.slip


def spread_of(slip: Slip) -> Spread:
    assert slip.spread is not None
    return slip.spread


AHEAD = Twist(1.0, 0.0, 0.0)
# What is known of each speed of omni4 at 1 m/s: a step of 2 pi/60/19.2032 rad/s at the rim, and 1 % of 0.866 m/s.
# The residual of each wheel is a quarter of the slip of one.
EXACT = 0.0004155 + 0.0086603


@pytest.mark.parametrize(("share", "seen"), [(0.99, False), (1.01, True)])
def test_the_threshold_is_what_wheels_are_known_to(share: float, seen: bool) -> None:
    wheels = Wheels()
    for _ in range(10):
        wheels.see(AHEAD)
    for _ in range(10):
        slip = wheels.see(AHEAD, (0.0, 4.0 * EXACT * share, 0.0, 0.0))
    assert slip.slipping is seen
    assert wheels.detector.threshold == pytest.approx(EXACT, rel=0.02)


def test_measurements_of_different_age_are_known_less() -> None:
    """A wheel 2 ms older than the others, at the most that all motors together can accelerate it."""
    fresh, skewed = Wheels(), Wheels()
    for _ in range(10):
        one = fresh.see(AHEAD, (0.0, 0.06, 0.0, 0.0))
        other = skewed.see(AHEAD, (0.0, 0.06, 0.0, 0.0), ages_ms=(0.5, 2.5, 0.5, 0.5))
    assert one.slipping
    assert not other.slipping


def test_it_has_to_last_and_ends_after_a_while() -> None:
    """20 ms and three cycles; 100 ms of less than half of it. On oil it swings through zero: that is no end."""
    wheels, seen = Wheels(), []
    wheels.see(AHEAD)
    for size in (*[0.1] * 6, *[0.0] * 20, 0.1, *[0.025] * 24, *[0.01] * 26):
        seen.append(wheels.see(AHEAD, (size, 0.0, 0.0, 0.0)).slipping)
    assert seen.index(True) == 4
    assert seen[4 : 4 + 22 + 25] == [True] * 47
    assert seen[-1] is False


def test_one_sample_and_a_lost_wheel_are_no_slip() -> None:
    wheels = Wheels()
    for _ in range(20):
        assert not wheels.see(AHEAD, (1.0, 0.0, 0.0, 0.0)).slipping
        for _ in range(30):
            assert not wheels.see(AHEAD).slipping
    for _ in range(20):
        assert wheels.see(AHEAD, (1.0, 0.0, 0.0, 0.0), unheard=2) == NO_SLIP


def test_three_cycles_are_needed_however_long_they_take() -> None:
    wheels = Wheels()
    wheels.see(AHEAD, dt=0.05)
    seen = [wheels.see(AHEAD, (0.1, 0.0, 0.0, 0.0), dt=0.05).slipping for _ in range(3)]
    assert seen == [False, False, True]


@pytest.mark.parametrize("count", [5, 6])
def test_of_five_and_six_wheels_the_residual_alone_names_it(count: int) -> None:
    """Without a torque and without a gyro; at once, but for one cycle in which nobody else may be found."""
    for place in range(count):
        wheels = Wheels(count)
        wheels.see(AHEAD)
        slips = [0.3 if other == place else 0.0 for other in range(count)]
        first, second = wheels.see(AHEAD, slips), wheels.see(AHEAD, slips)
        assert first.wheels == ()
        assert (second.wheels, second.evidence) == ((place,), ("residual",))


@pytest.mark.parametrize(
    ("misfits", "found"),
    [
        ((0.9, 2.1, 3.0, 9.0), 0),
        ((0.9, 1.9, 3.0, 9.0), None),  # the second does not fit, but not clearly
        ((1.1, 2.1, 3.0, 9.0), None),  # the best does not fit either
        ((2.1, 2.1, 3.0, 0.0), 3),
        ((2.1, 2.1, 3.0, 4.0), None),
    ],
)
def test_a_wheel_is_named_only_where_every_other_clearly_does_not_fit(
    misfits: tuple[float, ...], found: int | None
) -> None:
    check = model().redundancy.of((True,) * 4)
    assert check is not None
    assert _only(check, misfits) == found


@pytest.mark.parametrize("second", [1, 3])
@pytest.mark.parametrize("after", range(60, 140, 16))
def test_a_name_does_not_outlast_its_wheel(second: int, after: int) -> None:
    """Wheel 0, then at once one of the other diagonal, at any time of the 0.3 s in which evidence is gathered."""
    drag = (-0.09, -0.09, 0.09, 0.09)
    kick = 0.004 * (0.2 / R) / DT  # N m that bring a wheel that is free to that speed within a cycle
    wheels = Wheels()
    wheels.see(AHEAD, torques=drag)
    for cycle in range(after):
        slip = wheels.see(AHEAD, (0.2, 0.0, 0.0, 0.0), torques=(drag[0] + (kick if cycle == 0 else 0.0), *drag[1:]))
    assert slip.wheels == (0,)
    slips = [0.2 if place == second else 0.0 for place in range(4)]
    for cycle in range(60):
        kicks = [(place == second) - (place == 0) if cycle == 0 else 0 for place in range(4)]
        torques = [one + kick * times for one, times in zip(drag, kicks, strict=True)]
        slip = wheels.see(AHEAD, slips, torques=torques)
        assert slip.slipping
    assert 0 not in slip.wheels


def test_by_speeds_alone_four_wheels_say_that_one_slips_and_not_which() -> None:
    wheels = Wheels()
    wheels.see(AHEAD)
    for _ in range(100):
        slip = wheels.see(AHEAD, (0.2, 0.0, 0.0, 0.0))
    assert slip.slipping
    assert slip.wheels == ()
    assert slip.ahead == pytest.approx((0.05, -0.05, 0.05, -0.05))
    # The motion may be wrong by 0.05 (1/sin, 1/cos, 1/lever) for each, with any sign of the first two: uncorrelated.
    xx, xy, xt, yy, yt, tt = spread_of(slip)
    assert (xx, yy, tt) == pytest.approx(((0.05 / COSINE) ** 2, (0.05 / HALF) ** 2, (0.05 / LEVER) ** 2))
    assert (xy, xt, yt) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_a_gyro_leaves_two_of_four() -> None:
    """Wheels 0 and 2 would turn the body the same way: the gyro clears the two others, and that is in the spread."""
    wheels = Wheels()
    wheels.see(AHEAD, heading=Heading(0.0, True, True))
    for _ in range(100):
        slip = wheels.see(AHEAD, (0.2, 0.0, 0.0, 0.0), heading=Heading(0.0, True, False))
    assert slip.wheels == ()
    xx, xy, xt, yy, yt, tt = spread_of(slip)
    assert xy == pytest.approx(-xx * COSINE / HALF), "both are wrong along one line"
    assert (xt, yt) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert (yy, tt) == pytest.approx(((0.05 / HALF) ** 2, (0.05 / LEVER) ** 2))


def test_torques_name_it_and_a_gyro_that_contradicts_them_takes_the_name() -> None:
    """A steady drive: 0.09 N m of drag each, and wheel 0 turns ahead without moving the body."""
    drag = (-0.09, -0.09, 0.09, 0.09)
    wheels, doubted = Wheels(), Wheels()
    wheels.see(AHEAD, torques=drag)
    doubted.see(AHEAD, torques=drag, heading=Heading(0.0, True, True))
    for cycle in range(1, 60):
        spinning_up = (drag[0] + (0.004 * (0.2 / R) / DT if cycle == 1 else 0.0), *drag[1:])
        named = wheels.see(AHEAD, (0.2, 0.0, 0.0, 0.0), torques=spinning_up)
        turned = Heading(-0.25 * 2.0 * DT * cycle, True, False)  # as if wheel 1 or 3 had slipped
        nobody = doubted.see(AHEAD, (0.2, 0.0, 0.0, 0.0), torques=spinning_up, heading=turned)
    assert named.wheels == (0,)
    assert named.evidence == ("torque",)
    assert named.ahead == pytest.approx((0.2, 0.0, 0.0, 0.0))
    assert nobody.slipping
    assert nobody.wheels == ()


def test_the_motion_without_a_named_wheel_is_hardly_in_doubt_and_only_along_it() -> None:
    drag = (-0.09, -0.09, 0.09, 0.09)
    wheels = Wheels()
    wheels.see(AHEAD, torques=drag)
    for cycle in range(20):
        torques = (drag[0] + (0.004 * (0.2 / R) / DT if cycle == 0 else 0.0), *drag[1:])
        slip = wheels.see(AHEAD, (0.2, 0.0, 0.0, 0.0), torques=torques)
    x, y, t = -0.05 / COSINE, 0.05 / HALF, 0.05 / LEVER  # of front_left: axle at 60 degrees
    assert slip.wheels == (0,)
    expected = [0.01 * part for part in (x * x, x * y, x * t, y * y, y * t, t * t)]
    assert slip.spread == pytest.approx(expected)


# -- wheels that spin alike, which the residual does not see ----------------------------------------------------------


def spin_up(acceleration: float, torque: float, *, seconds: float = 0.1) -> tuple[Slip, Wheels]:
    """Front left and rear right speed up against each other, m/s^2 at the rim: a drive at 120 degrees."""
    wheels = Wheels()
    wheels.see(Twist(0.0, 0.0, 0.0), torques=(0.0,) * 4)
    for cycle in range(1, round(seconds / DT) + 1):
        rim = acceleration * DT * cycle
        slip = wheels.see(Twist(0.0, 0.0, 0.0), (rim, 0.0, -rim, 0.0), torques=(torque, 0.0, -torque, 0.0))
    return slip, wheels


def test_two_wheels_that_spin_alike_leave_no_residual_and_are_found_by_their_torque() -> None:
    """A start along 150 degrees at full torque, on ice: 4.5 N m on 0.004 kg m^2 and the residual cancels."""
    slip, _ = spin_up(40.0, 4.5)
    assert slip.slipping
    assert set(slip.wheels) == {0, 2}
    assert slip.evidence == ("spin",)
    assert slip.spread is not None
    quick, _ = spin_up(40.0, 4.5, seconds=0.028)
    assert quick.slipping


@pytest.mark.parametrize(
    ("acceleration", "torque"),
    [
        (40.0, -4.5),  # a push: the motors brake it
        (3.0, 0.5),  # what the limits of the body ask for
        (8.0, 4.5),  # as all this torque drives the body: 2 of 4 motors, 25 kg
    ],
)
def test_what_pushes_the_body_or_what_its_torque_explains_is_no_spin(acceleration: float, torque: float) -> None:
    slip, _ = spin_up(acceleration, torque)
    assert slip == NO_SLIP
