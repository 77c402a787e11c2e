"""The policy of regions on its own: what it sees is what a test says, and the chassis turns as it is told or not."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.control.manoeuvre import Form, Limits
from gateway.control.region_policy import RegionPolicy, Seen, still
from gateway.types import Rates, Region

D1 = 0.25
DT = 0.004
PULL, PUSH, ANY = Region.PULL, Region.PUSH, Region.ANY
LIMITS = Limits(velocity=1.0, acceleration=0.8, motor_speed=1.0)


class Robot:
    """Chassis and platform, ideal: what is told is done in the same cycle. `stuck`: nothing is."""

    def __init__(self, heading: float, *, form: Form = Form.ARC, bound: float = 1.0, d1: float = D1) -> None:
        self.policy = RegionPolicy(form=form, max_footprint=bound, limits=LIMITS, axle_offset=d1)
        self.heading = heading  # of the chassis; the platform looks along x
        self.x = self.y = self.way = self.speed = 0.0
        self.along = (1.0, 0.0)  # of the setpoint
        self.t = 0.0
        self.farthest = 0.0
        self.whole = True
        self.known = True
        self.stuck = False
        self.moving = False  # something does, whatever was told
        self.braking = 0.8  # m/s^2
        self.frozen: float | None = None  # angle of the joint that is measured whatever it does
        self.corrected = (1.57, 1.57)
        self.codes: list[str] = []
        self._d1 = d1

    def cycle(self, target: Rates, region: Region) -> Rates:
        size = math.hypot(*target[:2])
        if size > 0.0:
            self.along = (target[0] / size, target[1] / size)
        velocity = (self.speed * self.along[0], self.speed * self.along[1])
        seen = Seen(
            DT,
            (-self.heading if self.frozen is None else self.frozen) if self.known else None,
            self.way,
            velocity,
            self.speed == 0.0 and not self.moving,
            self.corrected,
            self.whole,
        )
        aimed = self.policy.aim(target, seen, region=region, path_rate=None)
        speed = math.hypot(*aimed[:2])
        self.speed = min(speed, self.speed + 0.8 * DT) if speed else max(0.0, self.speed - self.braking * DT)
        if self.policy.at_work:
            self.speed *= self.policy.share(self.speed, seen, at_rest=self.speed == 0.0)
        if self.policy.at_work and not self.stuck:
            along, across = self.policy.direction
            middle = self.heading + 0.5 * across * self.speed * DT / self._d1
            c, s = math.cos(middle), math.sin(middle)
            self.x += self.speed * DT * (along * c - across * s)
            self.y += self.speed * DT * (along * s + across * c)
            self.heading += across * self.speed * DT / self._d1
            self.way += along * self.speed * DT
        self.farthest = max(self.farthest, math.hypot(self.x, self.y))
        self.codes += [event.code for event in self.policy.news()]
        self.t += DT
        return aimed

    @property
    def facts(self) -> dict[str, float | str | bool | None]:
        return self.policy.facts

    @property
    def stage(self) -> str:
        return str(self.facts["manoeuvre"])

    def run(self, seconds: float, target: Rates, region: Region, *, until: str = "") -> Rates:
        aimed = target
        for _ in range(round(seconds / DT)):
            aimed = self.cycle(target, region)
            if self.stage == until:
                break
        return aimed


def off(robot: Robot, direction: float, region: Region) -> float:
    return abs(math.remainder(direction - robot.heading - (math.pi if region is PULL else 0.0), 2.0 * math.pi))


@settings(max_examples=60, deadline=None)
@given(
    heading=st.floats(-math.pi, math.pi),
    direction=st.floats(-math.pi, math.pi),
    region=st.sampled_from([PUSH, PULL]),
    form=st.sampled_from(Form),
    size=st.tuples(st.floats(0.05, 0.6), st.floats(0.05, 1.0)),
)
def test_whatever_it_is_asked_for_it_gets_there_within_what_it_told(
    heading: float, direction: float, region: Region, form: Form, size: tuple[float, float]
) -> None:
    d1, speed = size
    robot = Robot(heading, form=form, bound=5.0, d1=d1)
    target = (speed * math.cos(direction), speed * math.sin(direction), 0.0)
    before = off(robot, direction, region)
    robot.cycle(target, region)
    told, end = robot.facts, robot.heading
    robot.run(200.0, target, region, until="held")
    assert robot.stage == "held"
    if before <= 1.0 - 1e-9:
        assert (told["manoeuvre"], robot.heading) == ("held", end)
        return
    footprint, duration = told["manoeuvre_footprint"], told["manoeuvre_duration"]
    assert isinstance(footprint, float)
    assert isinstance(duration, float)
    assert off(robot, direction, region) <= 0.011
    assert robot.farthest <= footprint + 1e-6
    assert robot.farthest >= footprint - 0.02 * d1
    assert robot.t == pytest.approx(duration, rel=0.1, abs=0.15)
    if form is Form.CLOSED:
        assert math.hypot(robot.x, robot.y) <= 0.05 * d1


def test_it_waits_before_it_begins_and_tells_what_for() -> None:
    """0.2 s, in which nothing is aimed at."""
    robot = Robot(math.pi)
    for _ in range(50):
        assert robot.cycle((0.5, 0.0, 0.0), PUSH) == (0.0, 0.0, 0.0)
        assert robot.stage == "planned"
    robot.run(0.1, (0.5, 0.0, 0.0), PUSH)
    assert (robot.stage, robot.codes) == ("turning", ["manoeuvre_planned"])


@pytest.mark.parametrize("target", [(0.0, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.4, 0.15, 0.0)])
def test_taken_back_in_that_time_nothing_has_moved(target: Rates) -> None:
    robot = Robot(math.pi)
    robot.run(0.1, (0.5, 0.0, 0.0), PUSH)
    robot.cycle(target, PUSH)
    assert (robot.stage, robot.heading, robot.speed) == ("none", math.pi, 0.0)
    assert robot.codes == ["manoeuvre_planned", "manoeuvre_ended"]


def test_a_command_within_0_2_rad_is_the_same_and_beyond_another() -> None:
    for degrees, stage in ((10.0, "turning"), (-10.0, "turning"), (13.0, "ending"), (-13.0, "ending")):
        robot = Robot(math.pi)
        robot.run(1.0, (0.5, 0.0, 0.0), PUSH)
        robot.cycle((0.5 * math.cos(math.radians(degrees)), 0.5 * math.sin(math.radians(degrees)), 0.0), PUSH)
        assert robot.stage == stage


def test_braking_it_stays_on_its_piece_and_does_not_go_on() -> None:
    robot = Robot(math.pi)
    robot.run(1.0, (0.5, 0.0, 0.0), PUSH)
    heading, fast = robot.heading, robot.speed
    assert fast > 0.2
    robot.policy.brake()
    assert robot.cycle((0.5, 0.0, 0.0), PUSH) == (0.0, 0.0, 0.0)
    assert robot.stage == "ending"
    robot.run(2.0, (0.0, 0.0, 0.0), ANY)
    assert robot.stage == "none"
    assert 0.0 < abs(robot.heading - heading) <= fast * fast / (2.0 * 0.8) / D1 + 0.01
    assert robot.codes == ["manoeuvre_planned", "manoeuvre_ended"]


def test_braking_slower_than_it_would_have_landed_it_does_not_leave_its_piece() -> None:
    robot = Robot(math.pi)
    robot.run(2.4, (0.5, 0.0, 0.0), PUSH)
    left = min(robot.heading, 2.0 * math.pi - robot.heading)
    assert left * D1 < robot.speed**2 / (2.0 * 0.1) - 0.1
    robot.braking = 0.1
    robot.policy.brake()
    robot.run(5.0, (0.0, 0.0, 0.0), ANY)
    assert math.cos(robot.heading) > 0.999
    assert min(robot.heading, 2.0 * math.pi - robot.heading) < 0.02


def test_the_next_piece_begins_from_rest() -> None:
    robot = Robot(math.pi / 2.0, form=Form.CLOSED)
    robot.moving = True
    robot.cycle((0.5, 0.0, 0.0), PUSH)
    assert robot.stage == "resting"
    robot.moving = False
    robot.run(0.5, (0.5, 0.0, 0.0), PUSH)
    robot.moving = True
    robot.run(2.5, (0.5, 0.0, 0.0), PUSH)
    assert (robot.stage, robot.speed) == ("turning", 0.0)
    robot.moving = False
    robot.cycle((0.5, 0.0, 0.0), PUSH)
    assert robot.stage == "driving"


@pytest.mark.parametrize("held", [True, False], ids=["held", "frozen"])
def test_a_piece_is_driven_by_a_fifth_too_far_and_no_further(held: bool) -> None:
    """By something that holds it, or with an angle that stands still while it turns; then it is refused."""
    robot = Robot(math.pi)
    robot.stuck, robot.frozen = held, None if held else -math.pi
    target = (0.5, 0.0, 0.0)
    robot.run(60.0, target, PUSH, until="refused")
    assert robot.stage == "refused"
    assert robot.t < 5.0
    turned = abs(robot.heading - math.pi)
    assert turned == 0.0 if held else math.pi < turned < 1.2 * math.pi + 0.5
    assert robot.facts["manoeuvre_reason"] == (
        "driven further than planned: something holds it, or an angle that it goes by is wrong"
    )
    robot.run(1.0, target, PUSH)
    assert robot.stage == "refused"
    robot.stuck, robot.frozen = False, None
    robot.cycle((0.0, 0.0, 0.0), PUSH)
    robot.heading = math.pi
    robot.cycle(target, PUSH)
    assert robot.stage == "planned"


def test_one_that_did_not_lead_there_is_not_tried_again() -> None:
    """Somebody turned the chassis back while it was done."""
    robot = Robot(math.pi)
    robot.run(20.0, (0.5, 0.0, 0.0), PUSH, until="done")
    robot.heading = math.pi
    robot.run(1.0, (0.5, 0.0, 0.0), PUSH)
    assert robot.stage == "refused"
    assert robot.facts["manoeuvre_reason"] == "the manoeuvre has not reached the push region"


def test_one_that_does_not_come_to_rest_ends() -> None:
    """Something moves when its piece is done, a slope or a hand; it waited for rest for ever, and said nothing."""
    robot = Robot(math.pi)
    robot.run(1.0, (0.5, 0.0, 0.0), PUSH, until="turning")
    robot.moving = True
    robot.run(8.0, (0.5, 0.0, 0.0), PUSH)
    assert "manoeuvre_ended" in robot.codes
    assert "manoeuvre_done" not in robot.codes
    assert robot.stage in {"resting", "held"}


def test_with_a_motor_lost_it_begins_none_and_ends_the_one_at_work() -> None:
    robot = Robot(math.pi)
    robot.run(1.0, (0.5, 0.0, 0.0), PUSH)
    robot.whole = False
    robot.run(2.0, (0.5, 0.0, 0.0), PUSH)
    assert robot.stage == "refused"
    assert "manoeuvre_ended" in robot.codes
    assert robot.facts["manoeuvre_reason"] == "a motor is lost: no manoeuvre leads to the region"
    lying_well = Robot(0.0)
    lying_well.whole = False
    assert lying_well.cycle((0.5, 0.0, 0.0), PUSH) == (0.5, 0.0, 0.0)


@pytest.mark.parametrize("form", Form)
def test_an_angle_that_is_not_known_any_more_ends_it(form: Form) -> None:
    robot = Robot(math.pi, form=form)
    robot.run(1.0, (0.5, 0.0, 0.0), PUSH)
    robot.known = False
    assert robot.cycle((0.5, 0.0, 0.0), PUSH) == (0.0, 0.0, 0.0)
    assert robot.stage == "ending"
    robot.run(2.0, (0.5, 0.0, 0.0), PUSH)
    assert (robot.stage, robot.speed) == ("refused", 0.0)


def test_at_an_angle_that_is_not_known_nothing_is_begun() -> None:
    robot = Robot(0.0)
    robot.known = False
    assert robot.cycle((0.5, 0.0, 0.0), PUSH) == (0.0, 0.0, 0.0)
    assert robot.stage == "refused"


@pytest.mark.parametrize(("region", "heading"), [(PUSH, 1.2), (PULL, math.pi - 1.2)])
def test_what_is_driven_is_lost_beyond_1_3_rad_only(region: Region, heading: float) -> None:
    robot = Robot(0.0 if region is PUSH else math.pi)
    robot.run(1.0, (0.5, 0.0, 0.0), region)
    assert (robot.stage, robot.speed) == ("held", 0.5)
    robot.heading = heading
    assert robot.cycle((0.5, 0.0, 0.0), region) == (0.5, 0.0, 0.0)
    robot.heading += 0.2 if region is PUSH else -0.2
    assert robot.cycle((0.5, 0.0, 0.0), region) == (0.0, 0.0, 0.0)
    assert (robot.stage, robot.codes) == ("lost", ["region_lost"])
    robot.heading = 0.0 if region is PUSH else math.pi
    robot.run(3.0, (0.5, 0.0, 0.0), region)
    assert (robot.stage, robot.speed) == ("lost", 0.0)
    robot.cycle((0.0, 0.0, 0.0), region)
    assert robot.cycle((0.5, 0.0, 0.0), region) == (0.5, 0.0, 0.0)


def test_what_compensation_does_not_correct_is_not_driven_pulled() -> None:
    """Errors up to 0.3 rad are corrected: 0.27 is driven, 0.28 turned round first, and 0.31 lost."""
    for error, stage in ((0.26, "held"), (0.28, "planned")):
        robot = Robot(math.pi - error)
        robot.corrected = (0.3, 0.3)
        robot.cycle((0.5, 0.0, 0.0), PULL)
        assert robot.stage == stage
    robot = Robot(math.pi)
    robot.corrected = (0.3, 0.3)
    robot.run(1.0, (0.5, 0.0, 0.0), PULL)
    robot.heading = math.pi - 0.31
    robot.cycle((0.5, 0.0, 0.0), PULL)
    assert robot.stage == "lost"


@pytest.mark.parametrize(("region", "balance"), [(PUSH, 0.5236), (PULL, math.pi - 0.5236)])
def test_on_a_path_that_turns_it_turns_to_the_balance_of_that(region: Region, balance: float) -> None:
    """c = 0.5 m/s, 1 rad/s: asin(0.25/0.5) = 30 degrees off the straight one (science 1.3, Eq. 22)."""
    robot = Robot(balance)  # the motion, along x, then lies at -balance to the chassis: the mirror image
    robot.run(20.0, (0.5, 0.0, 1.0), region, until="held")
    assert "manoeuvre_done" in robot.codes
    assert math.remainder(-robot.heading - balance, 2.0 * math.pi) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(
    ("told", "rates", "expected"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True),
        (None, (0.01, 0.01, 0.1), True),
        ((0.0, 1e-9, 0.0), (0.0, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), (0.021, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0), (0.0, -0.021, 0.0), False),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.21), False),
        ((0.0, 0.0, 0.0), None, False),
    ],
)
def test_at_rest_is_what_was_not_told_to_move_and_does_not(
    told: tuple[float, ...] | None, rates: Rates | None, expected: bool
) -> None:
    assert still(told, rates) is expected
