"""Figures 7 to 12 of ASME Lett. Dyn. Sys. Control 2(4):040902: kinematics and dynamics of an omni robot.

Directly: the paper's equations, corrected (science 4 and 5), in its units. Through the service: the same motion as
commands.
"""

from collections.abc import Sequence
from math import atan2, cos, degrees, hypot, inf, pi, sin

import numpy as np

from gateway.types import Pose
from replay.reproduce.kane_model import LEVER, POUND, RADIUS, Array, KaneRobot, free, over_the_floor
from replay.reproduce.kane_robot import UNITS_NOTE, driven, kane_file, seen_from_above, settled
from replay.reproduce.omni_robot import robot_file
from replay.reproduce.picture import Line, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_most, within
from replay.reproduce.service import Order, Sample
from replay.sim.plants.omni_parameters import INCH

NOT_PRINTED = "not printed"
_STEP = 1e-3  # s
Place = tuple[float, float, float]  # in, in, rad


def figure_7(stage: Stage) -> Found:
    """Along a diagonal while spinning: q' = (10 in/s, 10 in/s, 5 rad/s)."""
    stage.tell("through the service")
    drive = driven(stage, lambda t, _: Order(10.0 * INCH, 10.0 * INCH, wz=5.0), 3.0)
    way = settled(drive.samples)
    stage.tell("kinematics")
    wheels = _wheels_at(10.0, 10.0, 5.0, seconds=3.0)
    places = _odometry(wheels)
    rows = (
        Row(
            "direction of the track, from the wheels",
            "deg",
            _direction(places),
            45.0,
            "x and y alike",
            within(45.0, 0.01),
        ),
        Row(
            "direction of the track, service",
            "deg",
            _direction([(s.x, s.y, s.heading) for s in way]),
            45.0,
            "",
            within(45.0, 1.0),
        ),
        Row("spin, from the wheels", "rad/s", places[-1][2] / 3.0, 5.0, "as given", within(5.0, 1e-6)),
        Row("spin, service", "rad/s", _spin(way), 5.0, "", within(5.0, 0.02)),
        Row("fastest wheel", "rad/s", float(np.max(np.abs(wheels))), None, NOT_PRINTED),
    )
    map_ = seen_from_above(
        drive.samples, Line("wheels integrated", [p[0] for p in places], [p[1] for p in places], dashed=True)
    )
    times = [_STEP * number for number in range(len(wheels))]
    speeds = Panel(
        "Wheels",
        "t [s]",
        "[rad/s]",
        lines=tuple(Line(f"wheel {i + 1}", times, [wheel[i] for wheel in wheels], i) for i in range(4)),
    )
    return Found(
        rows,
        Picture("Figure 7: forward kinematics, q' = (10, 10, 5)", ((map_, speeds),)),
        (UNITS_NOTE,),
        {"diagonal": drive.session},
    )


def figure_8(stage: Stage) -> Found:
    """Wheel speeds that no motion explains: the circle that they make on average, and the slip that they tell."""
    given = np.array([10.0, -8.0, 6.0, -4.0])
    robot = KaneRobot()
    twist = np.linalg.pinv(robot.wheels) @ given
    consistent = robot.wheels @ twist
    slip = float(given @ np.array([1.0, -1.0, -1.0, 1.0]))
    radius = hypot(twist[0], twist[1]) / abs(twist[2])
    stage.tell("through the service")

    def order(t: float, pose: Pose) -> Order:
        c, s = cos(pose.theta), sin(pose.theta)
        vx, vy = float(twist[0]) * INCH, float(twist[1]) * INCH
        return Order(c * vx - s * vy, s * vx + c * vy, wz=float(twist[2]))

    drive = driven(stage, order, 5.0)
    way = settled(drive.samples)
    xs, ys = [s.x / INCH for s in way], [s.y / INCH for s in way]
    told = 0.25 * (max(xs) - min(xs) + max(ys) - min(ys))
    config, _ = robot_file(kane_file())
    estimate = config.robot.kinematics().twist([float(speed) for speed in given], [None] * 4)
    rows = (
        Row(
            "slip that the wheels tell, w1 - w2 - w3 + w4",
            "rad/s",
            slip,
            None,
            "0 without slip",
            within(8.0, 1e-12),
        ),
        Row(
            "the same, from the residual of the service's kinematics",
            "rad/s",
            (estimate.residual or 0.0) * 2.0 / (RADIUS * INCH) if estimate is not None else inf,
            None,
            "its norm is half of the sum",
            within(8.0, 1e-9),
        ),
        Row("radius of the circle", "in", radius, None, NOT_PRINTED),
        Row("radius of the circle, service", "in", told, None, "", within(float(radius), 0.02 * float(radius))),
        Row("spin", "rad/s", float(twist[2]), None, NOT_PRINTED),
    )
    circle = _integrated([twist] * round(2.0 * pi / abs(twist[2]) / _STEP))
    map_ = seen_from_above(
        drive.samples, Line("least squares", [p[0] for p in circle], [p[1] for p in circle], dashed=True)
    )
    wheels = Panel(
        "Wheels: given, and what of them a motion explains",
        "wheel",
        "[rad/s]",
        lines=(
            Line("given", [1, 2, 3, 4], list(given)),
            Line("explained", [1, 2, 3, 4], [float(c) for c in consistent], 1, dashed=True),
        ),
    )
    note = (
        "The printed wheel speeds are not independent inputs: they violate the paper's own condition of no slip by 8 "
        "rad/s. What is driven is their least-squares part, (8, -6, 8, -6) rad/s."
    )
    return Found(
        rows,
        Picture("Figure 8: inverse kinematics, wheels (10, -8, 6, -4) rad/s", ((map_, wheels),)),
        (note, UNITS_NOTE),
        {"circle": drive.session},
    )


def figure_9(stage: Stage) -> Found:
    """Figures 9 to 12: spun up by torques, and left alone with what it has."""
    robot = KaneRobot()
    spinning, straight = np.array([0.0, 0.0, -RADIUS * 10.0 / LEVER]), np.array([RADIUS * 10.0, 0.0, 0.0])
    stage.tell("torques (10, -10, 10, -10) lbf in")
    spun = free(robot, np.zeros(3), POUND * np.array([10.0, -10.0, 10.0, -10.0]), seconds=5.0)
    stage.tell("left alone for 50 s")
    kept = {
        words: free(robot, velocity, np.zeros(4), seconds=50.0, step=5e-3)
        for words, velocity in (("spinning", spinning), ("straight", straight), ("both", spinning + straight))
    }
    stage.tell("through the service")
    drive = driven(stage, lambda t, _: Order(0.0, 0.0, wz=float(spinning[2])), 3.0)
    way = settled(drive.samples)
    drifts = {words: _drift(robot, states) for words, states in kept.items()}
    rows = (
        Row("spin after 5 s of torque", "rad/s", float(spun[-1][5]), None, NOT_PRINTED),
        Row("way beside the axis", "in", _apart(spun), 0.01, "the paper: a slight deviation", at_most(0.01)),
        Row(
            "spin of wheels at (10, -10, 10, -10) rad/s",
            "rad/s",
            float(spinning[2]),
            None,
            NOT_PRINTED,
            within(-3.75, 1e-12),
        ),
        Row(
            "way beside the axis, left alone",
            "in",
            _apart(kept["spinning"]),
            None,
            "it spins on the spot",
            at_most(1e-9),
        ),
        Row("energy, spinning", "lbf in", robot.energy(spinning), None, NOT_PRINTED, within(10.715, 5.1e-4)),
        Row("energy, straight on", "lbf in", robot.energy(straight), None, NOT_PRINTED, within(11.419, 5.1e-4)),
        Row("energy lost in 50 s, spinning", "1", drifts["spinning"], 0.0, "nothing takes any", at_most(1e-6)),
        Row("energy lost in 50 s, straight on", "1", drifts["straight"], 0.0, "nothing takes any", at_most(1e-6)),
        Row("energy lost in 50 s, both", "1", drifts["both"], None, "not in the paper", at_most(1e-6)),
        Row("spin, service", "rad/s", _spin(way), None, "", within(-3.75, 0.02)),
        Row(
            "way beside the axis, service",
            "in",
            max(hypot(s.x, s.y) for s in drive.samples) / INCH,
            None,
            "",
            at_most(0.1),
        ),
    )
    times = [1e-3 * number for number in range(len(spun))]
    wheels = [robot.wheels @ state[3:6] for state in spun]
    panels = (
        Panel(
            "Figure 10: wheels under torque",
            "t [s]",
            "[rad/s]",
            lines=tuple(Line(f"wheel {i + 1}", times, [float(w[i]) for w in wheels], i) for i in range(4)),
        ),
        Panel(
            "Figures 11 and 12: energy, left alone",
            "t [s]",
            "[lbf in]",
            lines=tuple(
                Line(words, [5e-3 * n for n in range(len(states))], [robot.energy(s[3:6]) for s in states], colour)
                for colour, (words, states) in enumerate(kept.items())
            ),
        ),
    )
    return Found(
        rows,
        Picture("Figures 9 to 12: torques, energy and momentum", (panels,)),
        (UNITS_NOTE,),
        {"spin": drive.session},
    )


def _wheels_at(u1: float, u2: float, spin: float, *, seconds: float) -> list[Array]:
    """Wheel speeds of this velocity over the floor, rad/s, from a heading of zero on (Eq. 14)."""
    robot, found = KaneRobot(), []
    for number in range(round(seconds / _STEP)):
        heading = spin * _STEP * (number + 0.5)  # in the middle of the step
        c, s = cos(heading), sin(heading)
        found.append(robot.wheels @ np.array([c * u1 + s * u2, -s * u1 + c * u2, spin]))
    return found


def _odometry(wheels: Sequence[Array]) -> list[Place]:
    """Eq. 15, integrated."""
    inverse = np.linalg.pinv(KaneRobot().wheels)
    return _integrated([inverse @ speeds for speeds in wheels])


def _integrated(twists: Sequence[Array]) -> list[Place]:
    """Places, in and rad, of body velocities that hold for a step each."""
    x = y = heading = 0.0
    found = [(x, y, heading)]
    for twist in twists:
        vx, vy, spin = over_the_floor(heading + 0.5 * _STEP * twist[2], twist)
        x, y, heading = x + float(vx) * _STEP, y + float(vy) * _STEP, heading + float(spin) * _STEP
        found.append((x, y, heading))
    return found


def _direction(places: Sequence[Place]) -> float:
    """Of the way from the first to the last, deg."""
    return degrees(atan2(places[-1][1] - places[0][1], places[-1][0] - places[0][0]))


def _spin(samples: Sequence[Sample]) -> float:
    """On average, rad/s."""
    return (samples[-1].heading - samples[0].heading) / (samples[-1].t - samples[0].t)


def _apart(states: Sequence[Array]) -> float:
    """The largest distance from the start, in."""
    return max(hypot(float(state[0]), float(state[1])) for state in states)


def _drift(robot: KaneRobot, states: Sequence[Array]) -> float:
    """The largest change of the energy, as a share."""
    first = robot.energy(states[0][3:6])
    return max(abs(robot.energy(state[3:6]) / first - 1.0) for state in states)
