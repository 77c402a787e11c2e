"""The wheel control of ASME Lett. Dyn. Sys. Control 2(4):040902 against the service's speed loop, along path files.

Both drive the paper's robot on the same plant (`OmniDynamics`) along the same two paths, and both are pushed once. The
wheel control is given the place of the path at every time (1 kHz, exact encoders, no bus), as the paper has it. The
service is led by `drivegate path`: velocities by odometry, over CAN, at 250 Hz. A third drive has the service's loop
with gains of the paper's pole placement, which is a line of the robot file.
"""

from collections.abc import Callable
from math import cos, hypot, pi, sin, sqrt
from typing import Final, NamedTuple

from gateway.paths.drive import PathDrive, demands_of
from gateway.paths.path import Path, Piece
from gateway.types import Pose, Twist
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.kane_model import WHEEL_GAINS, Gains
from replay.reproduce.kane_robot import MAX_TORQUE, OWN_LOOP, Loop, driven, kane_file
from replay.reproduce.omni_robot import robot_file
from replay.reproduce.picture import Line, Mark, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_most
from replay.reproduce.service import Driven, Order
from replay.sim.controllers.contract import STEP_S
from replay.sim.plants import plant_of
from replay.sim.plants.contract import PlantName
from replay.sim.plants.omni_parameters import INCH, SLUG

_SPEED = 0.5  # m/s
_PUSH = 10.0  # N along x of the floor, the weight of 1 kg on a robot of 3.7
_PUSHED = 0.4  # s
_COME_BACK = 0.8  # s after a push that are looked at with it
_EVERY_MS = 20  # between places that are looked at
_SQUARE_INCH = SLUG * INCH * INCH  # kg m^2 in a slug in^2
_CONTROLS: Final = ("wheel control", "service", "service, placed gains")
_SEARCH = 0.3  # m of way either side in which the nearest point of the path is looked for


def figure_eight() -> Path:
    """That of `deploy/paths/omni4_eight.toml`."""
    arc, curvature = 0.5 * 1.5 * pi, 2.0
    return Path(
        Pose(0.0, 0.0, pi / 4.0),
        [
            Piece("line", 0.5, 0.0, 0.0),
            Piece("arc", arc, -curvature, -curvature),
            Piece("line", 1.0, 0.0, 0.0),
            Piece("arc", arc, curvature, curvature),
            Piece("line", 0.5, 0.0, 0.0),
        ],
    )


def square() -> Path:
    """That of `deploy/paths/omni4_square.toml`."""
    corners = (0.0, pi / 2.0, pi / 2.0, pi / 2.0)
    return Path(Pose(0.0, 0.0, 0.0), [Piece("line", 2.0, 0.0, 0.0, corner) for corner in corners])


class _Course(NamedTuple):
    """A path, when the robot is pushed, and how far beside it one may come: mm, alone and pushed."""

    words: str
    path: Callable[[], Path]
    push: float
    bounds: tuple[float, float]


_COURSES: Final = (
    _Course("figure eight of arcs", figure_eight, 6.5, (15.0, 15.0)),
    _Course("square with sharp corners", square, 5.9, (30.0, 20.0)),
)


class _Way(NamedTuple):
    """What was driven: s, m over the floor, and mm to the left of the path."""

    times: list[float]
    xs: list[float]
    ys: list[float]
    beside: list[float]

    def part(self, start: float, end: float) -> list[float]:
        """Beside the path in that time."""
        return [left for t, left in zip(self.times, self.beside, strict=True) if start <= t < end]


def tracking(stage: Stage) -> Found:
    """Largest and root mean square distance beside the path, alone and pushed."""
    rows, panels, sessions = list[Row](), list[tuple[Panel, ...]](), {}
    for course in _COURSES:
        path = course.path()
        stage.tell(f"{course.words}: wheel control")
        ways = {_CONTROLS[0]: _wheel_control(path, course.push)}
        for words, loop in zip(_CONTROLS[1:], (OWN_LOOP, placed()), strict=True):
            stage.tell(f"{course.words}: {words}")
            drive = _through_the_service(stage, path, course.push, loop)
            ways[words] = _seen(path, drive)
            sessions[f"{course.words}, {words}"] = drive.session
        rows += _rows(course, ways)
        panels.append(_panels(course, path, ways))
    own, gains = OWN_LOOP, placed()
    notes = (
        "The paper's paths are its own (kane-fig13, kane-fig19); these are those of the service. Motors, gains of "
        f"the service ({own.kp:g} N m s/rad, {own.ki:g} N m/rad), speed ({_SPEED:g} m/s) and push ({_PUSH:g} N along x "
        f"for {_PUSHED:g} s) are ours.",
        f"Placed gains: Kd and Kp of the wheel control as kp and ki of the loop ({gains.kp:.3g}, {gains.ki:.3g}): "
        "the two are the same law but for its integral of the angle: the service corrects the place by odometry.",
        "The wheel control is told the place of the path at every time, jumps of speed in corners too; the service "
        "follows within its limits of acceleration and jerk, over CAN. In the arcs the service is further off, and not "
        "by its loop: what leads it reckons with 60 ms of delay whatever the robot, and this one has some 20 "
        "(told so, it is 0.5 mm beside the path instead of 13).",
        "With the placed gains it is as close behind corners, and gives as little to a push, as the wheel control. Its "
        "own are too soft: pushed by 20 N, the drive ends with fault_runaway.",
    )
    return Found(tuple(rows), Picture("Along paths, pushed: wheel control and service", panels), notes, sessions)


def placed() -> Loop:
    """The service's speed loop with the gains that place the paper's poles, of the stiffest wheel."""
    gains = _in_si(WHEEL_GAINS[2])
    return Loop(gains.derivative, gains.proportional)


def _in_si(gains: Gains) -> Gains:
    return Gains(*(gain * _SQUARE_INCH for gain in gains))


def _wheel_control(path: Path, push: float) -> _Way:
    """T' = Ki e + Kp e' + Kd e'' (Eq. 25) of each wheel, in the form without e'': T = Kd e' + a state of its own."""
    config, _ = robot_file(kane_file())
    plant, kinematics = plant_of(config.robot, PlantName.DYNAMICS), config.robot.kinematics()
    gains = [_in_si(one) for one in WHEEL_GAINS]
    way_at = _profile(path)
    states = [0.0] * len(gains)
    wanted, turned = [0.0] * len(gains), [0.0] * len(gains)
    found, seconds = _Way([], [], [], []), _seconds(path)
    for number in range(round(seconds / STEP_S)):
        t = number * STEP_S
        way, speed = way_at(t + 0.5 * STEP_S)
        heading = path.at(way).heading
        due = kinematics.wheel_speeds(Twist(speed * cos(heading), speed * sin(heading), 0.0), ())
        assert due is not None  # the wheels are fixed: there is nothing to be unknown
        torques = []
        for joint, (integral, proportional, derivative) in enumerate(gains):
            error, rate = wanted[joint] - turned[joint], due[joint] - plant.rates[joint]
            states[joint] += STEP_S * (integral * error + proportional * rate)
            torque = states[joint] + derivative * rate
            torques.append(max(-MAX_TORQUE, min(MAX_TORQUE, torque)))
            wanted[joint] += STEP_S * due[joint]
        before = plant.rates
        plant.push = _PUSH if push <= t < push + _PUSHED else 0.0
        plant.step(torques)
        turned = [a + 0.5 * STEP_S * (b + c) for a, b, c in zip(turned, before, plant.rates, strict=True)]
        if number % _EVERY_MS == 0:
            _add(found, t, plant.pose.x, plant.pose.y)
    return _beside(path, found)


def _through_the_service(stage: Stage, path: Path, push: float, loop: Loop) -> Driven:
    """As `drivegate path` leads it: every 20 ms from the newest odometry."""
    config, _ = robot_file(kane_file(loop))
    along = PathDrive(demands_of(config).follower(path, _SPEED), period=0.02)
    told = Order(0.0, 0.0)
    due = 0

    def order(t: float, pose: Pose) -> Order:
        nonlocal told, due
        if t >= 0.02 * due - 1e-9:
            step, due = along.step(t, pose.x, pose.y), due + 1
            told = Order(step.vx, step.vy, step.path_rate)
        return told

    def pushed(loop: ClosedLoop, t: float) -> None:
        loop.bus.robot.set_push(_PUSH if push <= t < push + _PUSHED else 0.0)

    return driven(stage, order, _seconds(path), pushed, loop)


def _profile(path: Path) -> Callable[[float], tuple[float, float]]:
    """Way and speed at a time: evenly faster, steady, and evenly slower to the end, as the service's follower asks."""
    acceleration = demands_of(robot_file(kane_file())[0]).acceleration
    rise, whole = _SPEED / acceleration, path.length / _SPEED

    def at(t: float) -> tuple[float, float]:
        if t < rise:
            return 0.5 * acceleration * t * t, acceleration * t
        left = max(0.0, whole + rise - t)
        if left < rise:
            return path.length - 0.5 * acceleration * left * left, acceleration * left
        return _SPEED * (t - 0.5 * rise), _SPEED

    return at


def _seconds(path: Path) -> float:
    return path.length / _SPEED + 1.0


def _seen(path: Path, drive: Driven) -> _Way:
    found = _Way([], [], [], [])
    for sample in drive.samples[:: _EVERY_MS // 4]:
        _add(found, sample.t, sample.x, sample.y)
    return _beside(path, found)


def _add(found: _Way, t: float, x: float, y: float) -> None:
    found.times.append(t)
    found.xs.append(x)
    found.ys.append(y)


def _beside(path: Path, found: _Way) -> _Way:
    """With how far it is beside the path: from its nearest point, as behind a corner there are two directions."""
    way = 0.0
    for x, y in zip(found.xs, found.ys, strict=True):
        way = path.nearest(x, y, between=(max(0.0, way - _SEARCH), min(way + _SEARCH, path.length)))
        point = path.at(way)
        left = -(x - point.x) * sin(point.heading) + (y - point.y) * cos(point.heading)
        distance = 1e3 * hypot(x - point.x, y - point.y)
        found.beside.append(distance if left >= 0.0 else -distance)
    return found


def _rows(course: _Course, ways: dict[str, _Way]) -> list[Row]:
    """Of the whole drive but for the push, and of the push and what comes after it."""
    rows = []
    end = course.push + _PUSHED + _COME_BACK
    for words, way in ways.items():
        alone, pushed = way.part(0.0, course.push) + way.part(end, 1e9), way.part(course.push, end)
        mine = words == _CONTROLS[0]
        name = f"{words}" if mine else f"{words.split(', ')[-1]}"
        for state, found, bound in (("alone", alone, course.bounds[0]), ("pushed", pushed, course.bounds[1])):
            suffix = "" if mine else ", service"
            what = f"{course.words}, {state}, {name}".removesuffix(", service") + suffix
            rows += [
                Row(f"largest, {what}", "mm", max(map(abs, found)), None, "", at_most(bound)),
                Row(f"rms, {what}", "mm", sqrt(sum(one * one for one in found) / len(found)), None, ""),
            ]
    return rows


def _panels(course: _Course, path: Path, ways: dict[str, _Way]) -> tuple[Panel, ...]:
    points = [path.at(path.length * number / 400.0) for number in range(401)]
    places = Line("path", [p.x for p in points], [p.y for p in points], 7, dashed=True)
    above = Panel(
        f"From above: {course.words}",
        "x [m]",
        "y [m]",
        lines=(*(Line(words, way.xs, way.ys, colour) for colour, (words, way) in enumerate(ways.items())), places),
        to_scale=True,
    )
    beside = Panel(
        f"Beside the path: {course.words}",
        "t [s]",
        "[mm]",
        lines=tuple(Line(words, way.times, way.beside, colour) for colour, (words, way) in enumerate(ways.items())),
        marks=(Mark("pushed", course.push, course.push + _PUSHED),),
    )
    return above, beside
