"""Finding how the floor grips, by launches of the real engine on a floor that is known."""

import contextlib
import os
import tomllib
from cmath import rect
from collections.abc import Callable, Mapping
from datetime import date
from math import hypot, pi
from pathlib import Path
from random import Random
from types import MappingProxyType
from unittest.mock import Mock

import pytest

from gateway import calibration
from gateway.calibration import HARDER, TRIES, Axis, CalibrationError, Driver, Found, Launch, Plans, find
from gateway.cli import calibrate
from gateway.config import load, parse
from gateway.control.launch import FRICTION, LOOKS, SAFE
from gateway.types import ZERO_TWIST, Facts, Mode, Request, RequestKind, Twist
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
        self.facts: Facts = {}

    def drive(self, launch: Launch, late: Mapping[int, int] = MappingProxyType({})) -> float:
        """`late`: ms without a cycle, by the number of the one before."""
        self.launches.append(launch)
        world, at = self.world, self.world.now_ns + self.world.period_ns
        setting = Request(RequestKind.SET, 1, at, setting=FRICTION, value=launch.friction)
        assert world.cycle(requests=[setting]).replies[0].ok
        twist = Twist(launch.speed, 0.0, 0.0) if launch.axis is Axis.X else Twist(0.0, launch.speed, 0.0)
        for wanted, seconds in ((twist, launch.seconds), (ZERO_TWIST, launch.seconds + 0.5)):
            for number in range(round(seconds * 1e9 / world.period_ns)):
                if number in late and wanted is twist:
                    world.loop.pause(world.now_ns + late[number] * 1_000_000)
                outputs = world.cycle(commands=[world.command(wanted)])
                self.facts = self.facts if outputs.status is None else outputs.status.chassis
                pose = world.bus.robot.truth.pose
                self.furthest = max(self.furthest, abs(pose.x), abs(pose.y))
        friction = self.facts[FRICTION]
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


def test_how_far_it_goes_counts_a_last_command_that_is_late() -> None:
    """It goes on at top speed until its source has been silent for too long."""
    patient = plans(lambda text: gripping(text).replace("timeout = 0.3", "timeout = 0.6"))
    speed = plans().launch(Axis.X, plans().first).speed
    assert patient.furthest() - plans().furthest() >= 0.3 * speed


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


def test_slip_that_a_harder_launch_does_not_show_was_none() -> None:
    """As a loop that was late may make it look."""
    asked: list[Launch] = []

    def drive(launch: Launch) -> float:
        asked.append(launch)
        slips = launch.friction > LIMIT or len(asked) in {1, 12, 31}
        return min(GIVEN, 0.9 * launch.friction) if slips else launch.friction

    found = find(plans(), drive, rounds=2)
    assert all(LIMIT < HARDER * one.taken_for <= HARDER * LIMIT * STEP for one in found)
    assert [one.friction for one in found] == [pytest.approx(GIVEN / SAFE)] * 4


class Unseen:
    """A client of a robot that goes by its friction whatever the floor; its loop is late in the first launches."""

    def __init__(self, late: int) -> None:
        self.late, self.launches, self.looks = late, 0, 0.0

    def drive(self, _: Launch) -> bool:
        self.launches += 1
        self.looks += self.launches > self.late
        return self.launches > self.late // 2


@pytest.mark.parametrize("late", [0, 3, TRIES])
def test_a_launch_that_was_not_looked_at_is_done_again(monkeypatch: pytest.MonkeyPatch, late: int) -> None:
    robot = Unseen(late)
    monkeypatch.setattr(Driver, "_launch", lambda _, launch: robot.drive(launch))
    monkeypatch.setattr(Driver, "_fact", lambda _, name: {LOOKS: robot.looks, FRICTION: 0.4}[name])
    client = Mock()
    client.odometry.return_value = Mock(x=0.0, y=0.0, theta=0.0)
    driver = Driver(client, "teleop", 0.8)
    launch = Launch(Axis.X, 0.4, 1.0, 0.3)
    if late < TRIES:
        assert driver(launch) == launch.friction
        assert robot.launches == late + 1
    else:
        with pytest.raises(CalibrationError, match="nothing could tell slip"):
            driver(launch)


@pytest.mark.parametrize("seed", range(20))
def test_however_often_launches_are_done_again_it_stays_within_one_of_where_it_began(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Launches that end anywhere on their way, of a robot that stands askew in `odom` and turns a little in each."""
    random = Random(seed)
    began = complex(random.uniform(-5.0, 5.0), random.uniform(-5.0, 5.0))
    place, theta, longest, looks = began, random.uniform(-pi, pi), 0.0, 0.0
    client = Mock()
    client.odometry.side_effect = lambda: Mock(x=place.real, y=place.imag, theta=theta)

    def drive(_: Driver, launch: Launch) -> bool:
        nonlocal place, theta, longest, looks
        length = random.random() * launch.speed * launch.seconds
        longest = max(longest, abs(launch.speed) * launch.seconds)
        place += rect(length, theta + (0.0 if launch.axis is Axis.X else pi / 2.0))
        theta += random.uniform(-0.005, 0.005)
        looks += random.random() < 0.3
        return random.random() < 0.5

    monkeypatch.setattr(Driver, "_launch", drive)
    monkeypatch.setattr(Driver, "_fact", lambda _, name: {LOOKS: looks, FRICTION: 0.1}[name])
    driver = Driver(client, "teleop", 0.8)
    for axis in Axis:
        first = place
        for friction in (0.2, 0.3, 0.4):
            for way in (1.0, -1.0):
                with contextlib.suppress(CalibrationError):  # not seen in all its tries
                    driver(Launch(axis, friction, way * friction, 1.0))
                assert abs(place - began) <= 1.05 * hypot(longest, abs(first - began))


def test_a_robot_that_does_not_tell_where_it_is_is_not_launched() -> None:
    client = Mock()
    client.odometry.return_value = None
    client.status.return_value.status = Mock(mode=Mode.IDLE, settings=(), chassis={LOOKS: 0.0})
    with pytest.raises(CalibrationError, match="does not tell where it is"):
        Driver(client, "teleop", 0.8)(Launch(Axis.X, 0.4, 1.0, 0.3))
    client.set.assert_not_called()


def test_nothing_that_waits_stands_between_the_commands_of_a_launch(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy computer a question takes longer than a source may be silent: the robot would be at rest again."""
    said: list[str] = []

    def saying(name: str, answer: object) -> Callable[..., object]:
        def say(*_: object, **__: object) -> object:
            said.append(name)
            return answer

        return say

    client = Mock()
    client.set.side_effect = saying("set", Mock(ok=True))
    client.status.side_effect = saying("ask", None)
    client.state.return_value.status = Mock(mode=Mode.IDLE, settings=())
    for name, answer in (("start", True), ("stream", "mode idle: waiting"), ("rest", True)):
        monkeypatch.setattr(calibration, name, saying(name, answer))
    driver = Driver(client, "teleop", 0.8)
    assert not driver._launch(Launch(Axis.X, 0.4, 1.0, 0.3)), "what was late is done again"
    assert said == ["set", "start", "stream", "rest"]
    client.state.return_value.status.mode = Mode.ESTOP
    with pytest.raises(CalibrationError, match="mode idle: waiting"):
        driver._launch(Launch(Axis.X, 0.4, 1.0, 0.3))


def test_a_robot_that_was_not_driven_is_not_armed_to_put_back_what_was_set() -> None:
    client = Mock()
    Driver(client, "teleop", 0.8).put_back()
    client.send_twist.assert_not_called()
    client.set.assert_called_once()


def test_looks_are_told_and_need_a_full_push_and_time() -> None:
    robot, launch = Robot(0.4), plans().launch(Axis.X, 0.3)
    robot.drive(launch)
    seen = robot.facts[LOOKS]
    assert isinstance(seen, float)
    assert seen > 0.0
    robot.drive(launch, late=dict.fromkeys(range(0, 80, 8), 30))
    assert robot.facts[LOOKS] == seen


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


# what it found, in the robot file

NOTE = "oak floor, 2026-01-02: 0.426 to 0.450 in 6 rounds"
WAYS_TO_SAY_IT = {
    "table": lambda text: text.replace("[loop]", "[robot.grip]\nfriction = 0.8  # as was guessed\n\n[loop]", 1),
    "inline": lambda text: text.replace("\n[robot.body]", "grip = { friction = 0.8 }  # guessed\n\n[robot.body]", 1),
    "dotted": lambda text: text.replace("\n[robot.body]", "grip.friction = 8e-1\n\n[robot.body]", 1),
    "quoted": lambda text: text.replace("[loop]", '["robot"."grip"]\n"friction" = 0.8\n\n[loop]', 1),
}


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
@pytest.mark.parametrize("way", WAYS_TO_SAY_IT)
def test_only_the_friction_of_the_file_is_changed(tmp_path: Path, way: str, ends: str) -> None:
    file, link = tmp_path / "robot.toml", tmp_path / "linked.toml"
    before = WAYS_TO_SAY_IT[way](robot_text("omni4")).replace("\n", ends)
    file.write_bytes(before.encode())
    file.chmod(0o640)
    link.symlink_to(file)
    calibrate.write(link, 0.42, NOTE)
    after = file.read_bytes().decode()
    told = [(old, new) for old, new in zip(before.split(ends), after.split(ends), strict=True) if old != new]
    assert len(told) == 1
    assert told[0][1].endswith(f"# {NOTE}")
    assert tomllib.loads(after)["robot"]["grip"] == {"friction": 0.42}
    load(file)
    assert file.stat().st_mode & 0o7777 == 0o640
    assert link.is_symlink()
    assert {one.name for one in tmp_path.iterdir()} == {"robot.toml", "linked.toml"}


def test_a_file_that_cannot_be_changed_is_known_before_the_robot_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(gripping(robot_text("omni4")))
    before = file.read_text()
    calibrate.rehearse(file, "oak floor")
    assert [one.name for one in tmp_path.iterdir()] == ["robot.toml"]

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", full)
        with pytest.raises(CalibrationError, match=r"robot\.toml cannot be written: No space left on device$"):
            calibrate.rehearse(file, "oak floor")
        with pytest.raises(CalibrationError, match=r"^friction = 0\.42 \(oak.*\) was found, but .*No space left"):
            calibrate.write(file, 0.42, NOTE)
    with monkeypatch.context() as guarded:  # for root nothing is read-only
        guarded.setattr(os, "access", lambda *_: False)
        with pytest.raises(CalibrationError, match="it is read-only"):
            calibrate.rehearse(file, "oak floor")
    assert [one.name for one in tmp_path.iterdir()] == ["robot.toml"]
    assert file.read_text() == before
    file.write_text(robot_text("omni4"))  # somebody else's change meanwhile
    with pytest.raises(CalibrationError, match=r"^friction = 0\.42 .* was found, but robot\.grip\.friction cannot be"):
        calibrate.write(file, 0.42, NOTE)


def test_an_interrupted_change_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(gripping(robot_text("omni4")))

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        calibrate.write(file, 0.42, NOTE)
    assert [one.name for one in tmp_path.iterdir()] == ["robot.toml"]


def test_a_surface_is_words_that_a_comment_can_say() -> None:
    assert calibrate.words_of(' "Eiche"\n# geölt,\t床\u2028') == '"Eiche" # geölt, 床'
    for surface in ("", " \n", "oak\x1b[31m", "oak\x00", "oak\x7f", "oak\udc80"):
        with pytest.raises(CalibrationError, match=r"^surface = .*: must say, in printable letters"):
            calibrate.words_of(surface)


def test_less_than_a_file_can_say_is_no_result() -> None:
    day = date(2026, 1, 2)
    oil = [Found(Axis.X, 0.06, 0.08), Found(Axis.Y, 0.031, 0.05)]
    with pytest.raises(CalibrationError, match=r"^the floor gives a friction of 0\.031, and less than 0\.05 is none$"):
        calibrate.summary(oil, "oil", day)
    assert calibrate.summary(oil[:1], "oil", day) == (0.06, "oil, 2026-01-02: 0.060 to 0.060 in 1 rounds")
