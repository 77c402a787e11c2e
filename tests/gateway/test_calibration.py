"""Finding how the floor grips, by launches of the real engine on a floor that is known."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import pytest

from gateway.calibration import Axis, CalibrationError, Found, Launch, Plans, find
from gateway.config import parse
from gateway.control.launch import FRICTION
from gateway.types import ZERO_TWIST, Facts, Request, RequestKind, Twist
from tests.world import World, robot_text

STEP = 1.05  # from launch to launch
LIMIT, GIVEN = 0.42, 0.36  # of a floor: what it bears, and what is told when it no longer does
MARGIN = 0.97  # of what the floor gives, that a launch asks


def gripping(text: str) -> str:
    """With limits of the body beyond what any floor here gives; and no height, as this plant shifts no loads."""
    for old, new in (
        ("centre_height", "# centre_height"),
        ("acceleration = { vx = 2.0, vy = 1.5, wz = 6.0 }", "acceleration = { vx = 9.0, vy = 9.0, wz = 30.0 }"),
        ("jerk = { vx = 15.0, vy = 12.0, wz = 40.0 }", "jerk = { vx = 40.0, vy = 40.0, wz = 120.0 }"),
        ("[loop]", "[robot.grip]\nfriction = 0.8\n\n[loop]"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    return text


class Robot:
    """A running omni4 on a floor of this friction, driven as the command drives it."""

    def __init__(self, friction: float) -> None:
        self.world = World("omni4", edit=gripping)
        self.world.start()
        self.world.bus.robot.set_floor(friction)
        self.furthest = 0.0
        self.launches: list[Launch] = []

    def drive(self, launch: Launch, late: Mapping[int, int] = MappingProxyType({})) -> float:
        """`late`: ms without a cycle, by the number of the one before."""
        self.launches.append(launch)
        world, at = self.world, self.world.now_ns + self.world.period_ns
        setting = Request(RequestKind.SET, 1, at, setting=FRICTION, value=launch.friction)
        assert world.cycle(requests=[setting]).replies[0].ok
        twist = Twist(launch.speed, 0.0, 0.0) if launch.axis is Axis.X else Twist(0.0, launch.speed, 0.0)
        facts: Facts = {}
        for wanted, seconds in ((twist, launch.seconds), (ZERO_TWIST, launch.seconds + 0.5)):
            for number in range(round(seconds * 1e9 / world.period_ns)):
                if number in late and wanted is twist:
                    world.loop.pause(world.now_ns + late[number] * 1_000_000)
                outputs = world.cycle(commands=[world.command(wanted)])
                facts = facts if outputs.status is None else outputs.status.chassis
                pose = world.bus.robot.truth.pose
                self.furthest = max(self.furthest, abs(pose.x), abs(pose.y))
        friction = facts[FRICTION]
        assert isinstance(friction, float)
        return friction


def plans(edit: Callable[[str], str] = gripping) -> Plans:
    return Plans(parse(edit(robot_text("omni4")), "omni4"))


def test_what_it_finds_is_what_the_floor_gives() -> None:
    friction = 0.4
    robot = Robot(friction)
    found = find(plans(), robot.drive, rounds=1)
    assert [one.axis for one in found] == [Axis.X, Axis.Y]
    for one in found:
        assert 0.95 * friction < one.friction < 1.03 * friction
        assert friction / MARGIN < one.taken_for < 1.3 * friction / MARGIN
    assert robot.furthest < plans().furthest()


def test_a_round_goes_up_out_and_back_until_wheels_slip() -> None:
    asked: list[Launch] = []

    def drive(launch: Launch) -> float:
        asked.append(launch)
        return launch.friction if launch.friction <= LIMIT or launch.speed > 0.0 else GIVEN

    told: list[Found] = []
    found = find(plans(), drive, rounds=3, told=told.append)
    assert found == told
    assert len(found) == 6
    for one in found:
        assert one.friction == pytest.approx(GIVEN / 0.95)
        assert LIMIT < one.taken_for <= LIMIT * STEP
    for out, back in zip(asked[::2], asked[1::2], strict=True):
        assert out.speed == -back.speed > 0.0
        assert out[:2] == back[:2]


class Endless(Plans):
    def launch(self, axis: Axis, friction: float) -> Launch:
        return Launch(axis, friction, 1.0, 1.0)


def test_more_than_any_floor_gives_is_not_looked_for() -> None:
    endless = Endless(parse(gripping(robot_text("omni4")), "omni4"))
    with pytest.raises(CalibrationError, match=r"^forward and back: nothing slipped, and more than .* 1\.\d* is none$"):
        find(endless, lambda launch: launch.friction, rounds=1)


def test_a_robot_that_does_not_obey_ends_it() -> None:
    def drive(launch: Launch) -> float:
        if launch.friction > LIMIT * 1.1:  # the harder pair
            raise CalibrationError("mode estop")
        return launch.friction if launch.friction <= LIMIT else GIVEN

    with pytest.raises(CalibrationError, match="mode estop"):
        find(plans(), drive, rounds=1)


def words(edit: Callable[[str], str]) -> str:
    with pytest.raises(CalibrationError) as caught:
        find(plans(edit), lambda launch: launch.friction, rounds=1)
    return str(caught.value)


def test_another_limit_than_the_floor_is_named() -> None:
    assert "no [robot.grip]" in words(lambda text: text)
    slow = words(lambda text: gripping(text).replace("vx = 9.0", "vx = 2.0"))
    assert slow.startswith("forward and back: with a friction of 0.")
    assert "the wheels hold all of limits.acceleration.vx = 2 m/s^2" in slow
    weak = words(lambda text: gripping(text).replace("max_torque = 4.5", "max_torque = 0.9"))
    assert "the wheels hold all that the motors give" in weak
    lame = words(lambda text: gripping(text).replace("jerk = { vx = 40.0", "jerk = { vx = 2.0"))
    assert "more than limits.velocity.vx" in lame
    assert "limits.jerk.vx" in lame


@pytest.mark.parametrize("first", [5, 11])
@pytest.mark.parametrize("gap", [4, 8])
def test_late_cycles_are_no_slip(first: int, gap: int) -> None:
    """Two of 30 ms in a short launch, on a floor that gives half as much again."""
    robot = Robot(0.3)
    launch = plans().launch(Axis.Y, 0.2)
    assert robot.drive(launch, late={first: 30, first + gap: 30}) == launch.friction
