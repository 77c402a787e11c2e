"""Driving along path files through the real core in virtual time: pushed off, the robot merges back."""

import math
from collections.abc import Callable
from pathlib import Path as File
from typing import NamedTuple

import pytest

from gateway.config import ConfigError, parse
from gateway.paths import path_file
from gateway.paths.drive import Demands, PathDrive, check, demands_of
from gateway.paths.path import Path
from gateway.types import ZERO_TWIST, Mode, Outputs, Pose, Twist, TwistCommand, TwistFrame
from tests.world import World, robot_text

PATHS = File(__file__).parent.parent.parent / "deploy" / "paths"
PULLED = "[robot.compensation]\ngain = 2.0\nregion = 1.57\n\n[robot.body]"


def bundled(name: str) -> Path:
    return path_file.parse((PATHS / f"{name}.toml").read_text(), f"{name}.toml")


def compensated(text: str) -> str:
    if "\n[robot.compensation]" in text:
        return text
    return text.replace("[robot.body]", PULLED, 1)


class Step(NamedTuple):
    """Time since the first order, s; measured beside the path and ahead of what was ordered before, m."""

    t: float
    way: float
    deviation: float
    mode: Mode


class Push(NamedTuple):
    """N along x of the floor, from this time on, s, for so long, s."""

    force: float
    start: float
    seconds: float


class Driven(NamedTuple):
    steps: list[Step]
    world: World
    end: Pose  # really

    def worst(self, low: float, high: float) -> float:
        """Largest deviation between two ways, m."""
        return max(abs(step.deviation) for step in self.steps if low <= step.way <= high)


def drive(
    name: str,
    path: Path,
    speed: float,
    push: Push | None = None,
    *,
    edit: Callable[[str], str] = str,
    seconds: float = 60.0,
) -> Driven:
    """As the commander does it: every 20 ms from the newest odometry, then zeros until it stands."""
    world = World(name, edit=edit)
    world.run(0.3)
    world.run(3.0, ZERO_TWIST, source="autonomy", until=lambda outputs: outputs.mode is Mode.DRIVE)
    demands = demands_of(world.config)
    check(demands.problems(path, speed), name)
    path = demands.fitted(path)
    along = PathDrive(demands.follower(path, speed), period=0.02)
    pose = Pose(0.0, 0.0, 0.0)  # where every robot begins
    steps: list[Step] = []
    for cycle in range(round(seconds * 250.0)):
        t = cycle / 250.0
        if push is not None:
            world.bus.robot.set_push(push.force if push.start <= t < push.start + push.seconds else 0.0)
        commands = []
        if cycle % 5 == 0:
            order = along.step(t, pose.x, pose.y)
            steps.append(Step(t, order.way, order.deviation, world.last.mode))
            assert not order.lost
            if order.arrived:
                break
            twist = Twist(order.vx, order.vy, 0.0)
            commands = [
                TwistCommand(
                    "autonomy",
                    twist,
                    TwistFrame.ODOM,
                    None,
                    world.now_ns + world.period_ns,
                    "autonomy",
                    path_rate=order.path_rate,
                )
            ]
        outputs = world.cycle(commands=commands)
        if outputs.odometry is not None:
            pose = outputs.odometry.pose
    else:
        pytest.fail(f"not at the end after {seconds} s: {steps[-1]}")
    world.run(3.0, ZERO_TWIST, source="autonomy", until=at_rest)
    return Driven(steps, world, world.bus.robot.truth.pose)


def at_rest(outputs: Outputs) -> bool:
    return outputs.status is not None and outputs.status.standing is True and not outputs.status.limits_active


def off(done: Driven, path: Path) -> float:
    """How far the robot really stands from the path's end, m."""
    end = path.at(path.length)
    return math.hypot(done.end.x - end.x, done.end.y - end.y)


def gammas(done: Driven) -> list[float]:
    """Of the chassis to its motion, while it moves, rad."""
    found = [outputs.trace.chassis[0] for _, outputs in done.world.records if outputs.trace.chassis]
    return [gamma for gamma in found if gamma is not None]


@pytest.mark.parametrize("push", [None, Push(250.0, 6.0, 0.4)], ids=["alone", "pushed"])
def test_a_square_with_sharp_corners(push: Push | None) -> None:
    """At 0.5 m/s 10 cm beside it behind a corner, 1 mm a metre later; pushed off by 17 cm, back a metre later."""
    path = bundled("omni4_square")
    done = drive("omni4", path, 0.5, push)
    assert all(step.mode is Mode.DRIVE for step in done.steps[1:])
    assert done.worst(0.0, 2.5) < 0.12
    assert done.worst(3.95, 8.0) < 0.12
    assert done.worst(0.0, 1.9) < 1e-3
    assert done.worst(3.75, 3.95) < 2e-3
    assert done.worst(7.0, 8.0) < 2e-3
    assert (done.worst(2.9, 3.3) > 0.1) is (push is not None)
    assert off(done, path) < 5e-3


@pytest.mark.parametrize(
    ("last", "speed", "most"),
    [
        ('kind = "line"\nlength = 0.4', 0.4, 0.01),
        ('kind = "line"\nlength = 0.2', 0.4, 0.01),
        ('kind = "arc"\nradius = 0.4\nangle = 1.0', 0.8, 0.03),
    ],
)
def test_a_corner_close_before_the_end(last: str, speed: float, most: float) -> None:
    """What the corner carried it off by is made good on the way that is left, be it shorter than a merge is otherwise.

    Without that it stood 0.09, 0.07 and 0.32 m from the end.
    """
    corner = '[[piece]]\nkind = "line"\nlength = 0.5\n[[piece]]\nkind = "corner"\nangle = 1.5708\n[[piece]]\n'
    path = path_file.parse(corner + last, "corner.toml")
    assert off(drive("omni4", path, speed), path) < most


@pytest.mark.parametrize("push", [None, Push(250.0, 6.0, 0.4)], ids=["alone", "pushed"])
def test_a_figure_eight_of_arcs(push: Push | None) -> None:
    """At 0.5 m/s 6.4 mm beside it in the arcs, 9 mm from its end; pushed off by 14 cm, back half a metre later."""
    path = bundled("omni4_eight")
    done = drive("omni4", path, 0.5, push)
    assert all(step.mode is Mode.DRIVE for step in done.steps[1:])
    assert done.worst(0.0, 2.4) < 8e-3
    assert done.worst(3.5, path.length) < 8e-3
    assert (done.worst(2.5, 3.4) > 0.1) is (push is not None)
    assert done.worst(0.0, path.length) < 0.15
    assert off(done, path) < 0.012


def test_the_course_pulled_and_pushed_off_in_the_middle() -> None:
    """At 0.5 m/s, 1200 N for half a second in its first bend: 10 to 16 cm off, and back on the way without the push.

    The compensation shifts the robot by 6 to 7 cm where the curvature changes, with and without the push.
    """
    path = bundled("moby_course")
    alone = drive("moby", path, 0.5, edit=compensated)
    pushed = drive("moby", path, 0.5, Push(1200.0, 10.0, 0.5), edit=compensated)
    assert alone.worst(0.0, path.length) < 0.085
    assert alone.worst(0.0, 1.0) < 5e-3
    assert 0.09 < pushed.worst(4.6, 6.5) < 0.18
    assert pushed.worst(9.4, path.length) < alone.worst(9.4, path.length) + 0.01
    for done in (alone, pushed):
        assert done.worst(10.6, path.length) < 0.015
        assert off(done, path) < 0.015
        assert min(abs(gamma) for gamma in gammas(done)) > math.pi / 2, "pulled all the way"


def test_the_course_without_compensation() -> None:
    """The chassis flips, the joint stays within 5 mm of the path; a push takes it off by 9 cm, for 2 m of way."""
    path = bundled("moby_course")
    done = drive("moby", path, 0.5, Push(1200.0, 10.0, 0.5))
    assert abs(gammas(done)[-100]) < 0.1
    assert done.worst(0.0, 4.6) < 6e-3
    assert 0.07 < done.worst(4.6, 6.5) < 0.12
    assert done.worst(6.7, path.length) < 6e-3
    assert off(done, path) < 5e-3


def test_arcs_joined_on_the_axle_leave_little_to_correct() -> None:
    """At 0.4 m/s 11 mm beside the path; the same arcs joined tangent 76 mm, and four times the error of gamma."""
    text = (PATHS / "moby_arcs.toml").read_text()
    on_axle, tangent = (
        path_file.parse(text.replace("on_axle", joints), "moby_arcs.toml") for joints in ("on_axle", "tangent")
    )
    with_jumps = drive("moby", on_axle, 0.4, edit=compensated)
    without = drive("moby", tangent, 0.4, edit=compensated)
    assert with_jumps.worst(0.0, on_axle.length) < 0.02
    assert without.worst(0.0, tangent.length) > 0.05
    assert mean_error(with_jumps) < 0.4 * mean_error(without)
    assert off(with_jumps, demands(compensated).fitted(on_axle)) < 0.02
    assert all(step.mode is Mode.DRIVE for step in with_jumps.steps[1:])


def mean_error(done: Driven) -> float:
    """Of gamma from its goal, rad."""
    found = [outputs.trace.chassis[2] for _, outputs in done.world.records if outputs.trace.chassis]
    errors = [abs(error) for error in found if error is not None]
    return sum(errors) / len(errors)


def test_joints_on_the_axle_are_for_lines_and_arcs_and_for_a_robot_that_has_an_axle() -> None:
    on_axle = 'joints = "on_axle"\n'
    clothoids = (PATHS / "moby_course.toml").read_text()
    with pytest.raises(
        ConfigError, match=r"piece\[1\] \(clothoid\): must be a line or an arc where joints are on_axle"
    ):
        path_file.parse(on_axle + clothoids, "c.toml")
    path = bundled("moby_arcs")
    assert demands(name="omni4").problems(path, 0.3) == [
        "joints = 'on_axle': must be 'tangent': this robot has no axle behind its joint"
    ]
    assert demands().problems(path, 0.3) == []
    assert demands().fitted(path).smallest_radius == pytest.approx(1.5)


def demands(edit: Callable[[str], str] = str, name: str = "moby") -> Demands:
    return demands_of(parse(edit(robot_text(name)), name))


def test_what_a_pulled_robot_cannot_drive_is_named_with_its_place() -> None:
    corner = bundled("omni4_square")
    assert demands().problems(corner, 0.3)[0] == (
        "piece[1] (corner), 2.000 m from the start: turns by 1.5708 rad at once: "
        "a chassis is pulled along smooth paths only"
    )
    tight = path_file.parse("[[piece]]\nkind = 'arc'\nradius = 0.2\nangle = 1.0\n", "tight.toml")
    assert demands().problems(tight, 0.3) == [
        "piece[0] (arc), 0.000 m from the start: radius 0.2 m: must be at least the axle offset, 0.25 m"
    ]
    with pytest.raises(ConfigError, match=r"tight.toml: piece\[0\] \(arc\), 0.000 m from the start: radius 0.2 m"):
        check(demands().problems(tight, 0.3), "tight.toml")
    assert demands(name="omni4").problems(corner, 0.3) == demands(name="omni4").problems(tight, 0.3) == []


@pytest.mark.parametrize(("name", "most"), [("moby", "1.2"), ("omni4", "1.5")])
def test_a_path_goes_any_way_so_the_slower_axis_counts(name: str, most: str) -> None:
    line = path_file.parse("[[piece]]\nkind = 'line'\nlength = 1.0\n", "line.toml")
    assert demands(name=name).problems(line, 1.6) == [f"speed = 1.6: must be above 0 and at most {most} m/s, any way"]


def test_it_begins_only_near_the_start_and_lying_for_it() -> None:
    """moby stands with its chassis along x; pulled it goes the other way."""
    course, line = bundled("moby_course"), path_file.parse("[[piece]]\nkind = 'line'\nlength = 1.0\n", "line.toml")
    pulled = demands(compensated)
    assert pulled.start_problems(course, 0.2, -0.1, 0.04) == []
    assert pulled.start_problems(course, 0.3, 0.4, 0.0) == [
        "start: x 0 m, y 0 m is 0.500 m from the robot at x 0.300 m, y 0.400 m: must be within 0.25 m"
    ]
    assert pulled.start_problems(course, 0.0, 0.0, 0.1) == [
        "start: -0.100 rad from the direction in which the chassis is pulled: must be within 0.05"
    ]
    assert len(pulled.start_problems(line, 0.0, 0.0, 0.0)) == 1
    assert pulled.start_problems(line, 0.0, 0.0, None) == [
        "start: how the chassis lies is not known: the joint tells no angle"
    ]
    assert pulled._replace(pulled=False).start_problems(line, 0.0, 0.0, 0.0) == []
    assert demands(name="omni4").start_problems(line, 0.0, 0.0, None) == []


def test_how_long_it_takes() -> None:
    """moby: 0.4 m/s^2. 1 m at 0.4 m/s: 2.5 s and 1 s of ramps; 0.1 m never gets fast: 2 sqrt(0.1/0.4)."""
    moby = demands()
    for length, seconds in ((1.0, 3.5), (0.1, 1.0)):
        line = path_file.parse(f"[[piece]]\nkind = 'line'\nlength = {length}\n", "line.toml")
        assert moby.seconds(line, 0.4) == pytest.approx(seconds)
