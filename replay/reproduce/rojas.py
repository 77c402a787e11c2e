"""Figures and claims of Rojas, Omnidirectional Control (2005), but for the launch: forces, rollers, slip, dead motors.

Directly: its matrices, corrected (science 2 and 5), as the service's kinematics computes them. Through the service: a
robot with those wheels. Directions are the paper's: 0 degrees is to the right, 90 forward.
"""

from collections.abc import Callable, Sequence
from math import cos, degrees, hypot, inf, pi, radians, sin, sqrt

from gateway.kinematics.forces import PushTable, force_coupling, least_forces
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.omni_robot import robot_file
from replay.reproduce.picture import Level, Line, Mark, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_most, within
from replay.reproduce.rojas_robot import (
    CIRCLE,
    FORCE,
    MASS,
    MOTORS,
    SYMMETRIC,
    TORQUE,
    WHEEL_RADIUS,
    Layout,
    ahead,
    driven,
    rim_speeds,
    rojas_file,
    towards,
    wheel_directions,
)
from replay.reproduce.service import Driven, Sample

NOT_PRINTED = "not printed"
ALL = (True,) * len(MOTORS)
_TOP = 1.5  # m/s, of the drives
_SHARE = 0.6  # of what the motors could do, in the drives of figure 4
_SHOWN = tuple(radians(2.0 * step) for step in range(181))  # directions of a curve
_ASYMMETRIC = Layout(30.0, 45.0)  # of figure 4; its angles are not printed


def figure_4(stage: Stage) -> Found:
    """How many motors push in each direction; and that each direction asks as much of the strongest motor."""
    counts = {direction: _motors(SYMMETRIC, direction) for direction in (90.0, 45.0, 0.0, 30.0)}
    drives = {}
    for words, direction in (("forward", 90.0), ("diagonally", 45.0), ("sideways", 0.0)):
        stage.tell(f"through the service, {words}")
        drives[words] = _speeding_up(stage, direction, _SHARE * counts[direction] * FORCE / MASS)
    rows = (
        Row(
            "motors forward", "1", counts[90.0], 3.7, "4 cos(phi), phi 30 deg; the print is off", within(3.464, 5.1e-4)
        ),
        Row("motors at 45 deg", "1", counts[45.0], 2.0, "printed: that of sideways, swapped", within(1.793, 5.1e-4)),
        Row("motors sideways", "1", counts[0.0], 1.8, "printed: that of 45 deg, swapped", within(2.0, 1e-9)),
        Row("motors in the weakest direction, 30 deg", "1", counts[30.0], None, NOT_PRINTED, within(1.732, 5.1e-4)),
        *(
            Row(
                f"motors that push while speeding up {words}, service",
                "1",
                _told_motors(drive, direction),
                None,
                "mass times acceleration, by the push of the wheel that pushes most",
                within(counts[direction], 0.04 * counts[direction]),
            )
            for (words, drive), direction in zip(drives.items(), (90.0, 45.0, 0.0), strict=True)
        ),
    )
    polar = Panel(
        "Effective motors: how far the curve is away is how many push that way",
        "to the right",
        "forward",
        lines=tuple(
            Line(
                words,
                [_motors(layout, degrees(angle)) * cos(angle) for angle in _SHOWN],
                [_motors(layout, degrees(angle)) * sin(angle) for angle in _SHOWN],
                colour,
                dashed=bool(colour),
            )
            for colour, (words, layout) in enumerate(
                (("phi = 30 deg", SYMMETRIC), ("phi = 30, theta = 45 deg", _ASYMMETRIC))
            )
        ),
        to_scale=True,
    )
    torques = Panel(
        "Torque of the hardest working wheel, service",
        "t [s]",
        "[N m]",
        lines=tuple(
            Line(words, [s.t for s in drive.samples], [max(map(abs, s.torques)) for s in drive.samples], colour)
            for colour, (words, drive) in enumerate(drives.items())
        ),
        levels=(Level("60 % of a motor", _SHARE * TORQUE),),
    )
    notes = (
        "The paper's 3.7 is an error of arithmetic, and its figures for 45 degrees and sideways are swapped.",
        "Angles of the asymmetrical robot of figure 4 are not printed; 45 degrees behind is ours.",
    )
    return Found(
        rows,
        Picture("Figure 4: effective motors", ((polar, torques),)),
        notes,
        {words: drive.session for words, drive in drives.items()},
    )


def figure_9(stage: Stage) -> Found:
    """What of the speed the rollers provide, by direction and by the angle of the axles."""
    cases = (  # axles, direction, what the paper says of it in words, ours
        (45.0, 90.0, 0.30, 0.293),
        (45.0, 20.0, 0.30, 0.293),
        (30.0, 90.0, 0.15, 0.134),
        (30.0, 0.0, 0.50, 0.5),
        (9.0, 0.0, 0.80, 0.844),
    )
    rows, sessions = [], {}
    for axles, direction, paper, reference in cases:
        layout = Layout(axles, axles)
        words = f"axles at {axles:g} deg, towards {direction:g} deg"
        stage.tell(words)
        drive = _steadily(stage, layout, direction)
        sessions[words] = drive.session
        told = [s for s in drive.samples if s.t > 1.0]
        rows += [
            Row(
                f"share of the rollers, {words}",
                "1",
                _roller_share(layout, direction),
                paper,
                "",
                within(reference, 5.1e-4),
            ),
            Row(
                f"share of the rollers, {words}, service",
                "1",
                sum(_driven_share(sample) for sample in told) / len(told),
                None,
                "from the wheels' real turning",
                within(reference, 5e-3),
            ),
        ]
    angles = [degrees(angle) for angle in _SHOWN]
    curves = Panel(
        "What of the speed the rollers provide",
        "direction [deg]",
        "share",
        lines=tuple(
            Line(f"axles at {axles:g} deg", angles, [_roller_share(Layout(axles, axles), a) for a in angles], colour)
            for colour, axles in enumerate((45.0, 30.0, 20.0, 9.0))
        ),
    )
    note = (
        "The share is one less the root mean square of what the wheels roll, in parts of the speed: inferred, for then "
        "it is constant at 45 deg, as the paper says."
    )
    return Found(tuple(rows), Picture("Figure 9: rollers", ((curves,),)), (note,), sessions)


def slip_table(stage: Stage) -> Found:
    """Section 9: which wheel speeds are consistent, and a wheel that slips on a patch of oil."""
    rows = [
        Row(
            f"v1 - v2 + v3 - v4 of {words}", "m/s", abs(_slip(SYMMETRIC, speeds)), 0.0, "no wheel slips", at_most(1e-12)
        )
        for words, speeds in (
            ("forward (1, -1, -1, 1)", (1.0, -1.0, -1.0, 1.0)),
            ("sideways (-1, -1, 1, 1)", (-1.0, -1.0, 1.0, 1.0)),
            ("rotation (1, 1, 1, 1)", (1.0, 1.0, 1.0, 1.0)),
            ("any motion", tuple(rim_speeds(SYMMETRIC, 0.7, -0.4, 1.3))),
        )
    ]
    for wheel in range(len(MOTORS)):
        speeds = [speed + 0.1 * (place == wheel) for place, speed in enumerate(rim_speeds(SYMMETRIC, 0.7, -0.4, 1.3))]
        rows.append(
            Row(
                f"the same with wheel {wheel + 1} 0.1 m/s too fast",
                "m/s",
                abs(_slip(SYMMETRIC, speeds)),
                None,
                "its sign goes by the diagonal, and names no wheel",
                within(0.1, 1e-12),
            )
        )
    stage.tell("through the service, onto oil")
    drive = driven(stage, SYMMETRIC, lambda t, _: towards(90.0, _TOP), 2.0, acceleration=4.0, disturb=_oil)
    tells = [_slip(SYMMETRIC, [WHEEL_RADIUS * rate for rate in sample.rates]) for sample in drive.samples]
    real = [_real_slip(sample) for sample in drive.samples]
    worst = max(range(len(real)), key=lambda at: max(map(abs, real[at])))
    rows += [
        Row(
            "fastest slip of the wheel on oil, service", "m/s", abs(real[worst][0]), None, "wheel 1, mu 0.05 for 0.3 s"
        ),
        Row(
            "what the test tells then, by it, service",
            "1",
            abs(tells[worst] / real[worst][0]),
            None,
            "all of it, where no other wheel slips",
            within(1.0, 0.1),
        ),
    ]
    times = [sample.t for sample in drive.samples]
    panel = Panel(
        "A wheel on oil",
        "t [s]",
        "[m/s]",
        lines=(
            Line("v1 - v2 + v3 - v4", times, tells),
            Line("slip of wheel 1", times, [one[0] for one in real], 1, dashed=True),
        ),
        marks=(Mark("oil under wheel 1", *_OIL),),
    )
    note = (
        "Four wheels tell that one slips and how fast, not which: the residual is the same for both wheels of a "
        "diagonal."
    )
    return Found(tuple(rows), Picture("Section 9: slip", ((panel,),)), (note,), {"oil": drive.session})


def dead_motors(stage: Stage) -> Found:
    """Section 11: each of the four motors without power, and what the others do for it."""
    config, _ = robot_file(rojas_file(SYMMETRIC))
    kinematics = config.robot.kinematics()
    mass = ((MASS, 0.0, 0.0), (0.0, MASS, 0.0), (0.0, 0.0, config.robot.body.inertia))
    rims = tuple(tuple(part * WHEEL_RADIUS for part in row) for row in kinematics.matrix([0.0] * len(MOTORS)))
    coupling = force_coupling(rims, mass)
    rows, sessions, drives = [], {}, {}
    for dead, name in enumerate(MOTORS):
        usable = tuple(place != dead for place in range(len(MOTORS)))
        worst = 0.0
        for wanted in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.7, -0.4, 2.0)):
            forces = least_forces(coupling, wanted, usable)
            assert forces is not None  # three wheels reach everything
            given = [sum(c * f for c, f in zip(row, forces, strict=True)) for row in coupling]
            worst = max(worst, *(abs(a - b) for a, b in zip(given, wanted, strict=True)), abs(forces[dead]))
        half = _motors(SYMMETRIC, 90.0, usable) / _motors(SYMMETRIC, 90.0)
        stage.tell(f"through the service, without {name}")
        drive = driven(
            stage, SYMMETRIC, lambda t, _: towards(90.0, 0.5 * _TOP if t < 1.0 else _TOP), 3.0, disturb=_dying(name)
        )
        sessions[f"without {name}"], drives[name] = drive.session, drive
        end = drive.samples[-1]
        rows += [
            Row(
                f"error of accelerations without motor {dead + 1}",
                "m/s^2",
                worst,
                None,
                "the others suffice",
                at_most(1e-12),
            ),
            Row(
                f"push forward without motor {dead + 1}",
                "of all four",
                half,
                0.5,
                "half the acceleration",
                within(0.5, 1e-12),
            ),
            Row(
                f"speed in the end without motor {dead + 1}, service",
                "m/s",
                hypot(end.vx, end.vy),
                None,
                "1.5 wanted",
                within(_TOP, 0.03),
            ),
            Row(
                f"off the course without motor {dead + 1}, service",
                "mm",
                1e3 * max(abs(s.y) for s in drive.samples),
                None,
                "in 3 s; while speeding up only the wheels that push fall behind",
                at_most(150.0),
            ),
            Row(
                f"turned by, without motor {dead + 1}, service",
                "deg",
                max(abs(degrees(s.heading)) for s in drive.samples),
                None,
                "",
                at_most(2.0),
            ),
        ]
    speed = Panel(
        "Speed: the motor dies at 0.5 s, faster is asked for at 1 s",
        "t [s]",
        "[m/s]",
        lines=tuple(
            Line(f"without {name}", [s.t for s in d.samples], [hypot(s.vx, s.vy) for s in d.samples], colour)
            for colour, (name, d) in enumerate(drives.items())
        ),
        marks=(Mark("dead", _DEATH, _DEATH),),
    )
    way = Panel(
        "From above, forward to the right",
        "[m]",
        "[m]",
        lines=tuple(
            Line(f"without {name}", [s.x for s in d.samples], [s.y for s in d.samples], colour)
            for colour, (name, d) in enumerate(drives.items())
        ),
    )
    notes = (
        'The paper says "half as fast": it is half the acceleration; the dead wheel rolls along, and the top speed is '
        "the same. It also speaks of two inactive motors; generally it is the dead one alone.",
        "The service finds the motor silent by itself, lets it roll, and drives on with the others (mode degraded).",
    )
    return Found(tuple(rows), Picture("Section 11: without one motor", ((way, speed),)), notes, sessions)


_OIL = (0.1, 0.4)  # s
_DEATH = 0.5  # s


def _oil(loop: ClosedLoop, t: float) -> None:
    loop.bus.robot.set_friction(MOTORS[0], 0.05 if _OIL[0] <= t < _OIL[1] else inf)


def _dying(name: str) -> Callable[[ClosedLoop, float], None]:
    def disturb(loop: ClosedLoop, t: float) -> None:
        if abs(t - _DEATH) < 1e-9:
            loop.bus.robot.devices[name].power_off()

    return disturb


def _motors(layout: Layout, direction: float, usable: Sequence[bool] = ALL) -> float:
    """That push in a direction, deg from the right-hand side."""
    rows = [(x, y, CIRCLE) for x, y in wheel_directions(layout)]
    return PushTable(tuple(rows), (1.0,) * len(MOTORS)).along(radians(direction) - pi / 2.0, usable)


def _steadily(stage: Stage, layout: Layout, direction: float) -> Driven:
    return driven(stage, layout, lambda t, _: towards(direction, _TOP), 1.5, acceleration=3.0)


def _speeding_up(stage: Stage, direction: float, acceleration: float) -> Driven:
    """To full speed in a direction with so many m/s^2."""
    x, y = ahead(direction)
    limit = acceleration * max(abs(x), abs(y))  # of each axis: the direction is kept, so the larger one bounds it
    return driven(stage, SYMMETRIC, lambda t, _: towards(direction, _TOP), 1.0, acceleration=limit)


def _told_motors(drive: Driven, direction: float) -> float:
    """Effective motors, from the mean torque and the acceleration in the middle of speeding up."""
    x, y = ahead(direction)
    middle = [s for s in drive.samples if 0.3 * _TOP < x * s.vx + y * s.vy < 0.8 * _TOP]
    first, last = middle[0], middle[-1]
    acceleration = (x * (last.vx - first.vx) + y * (last.vy - first.vy)) / (last.t - first.t)
    torque = sum(max(map(abs, sample.torques)) for sample in middle) / len(middle)
    return MASS * acceleration * WHEEL_RADIUS / torque


def _roller_share(layout: Layout, direction: float) -> float:
    speeds = rim_speeds(layout, *ahead(direction))
    return 1.0 - sqrt(sum(speed * speed for speed in speeds) / len(speeds))


def _driven_share(sample: Sample) -> float:
    """The same of wheels that turn as they do."""
    square = sum((WHEEL_RADIUS * rate) ** 2 for rate in sample.rates) / len(sample.rates)
    return 1.0 - sqrt(square) / hypot(sample.vx, sample.vy)


def _slip(layout: Layout, speeds: Sequence[float]) -> float:
    """v1 - v2 + v3 - v4 of rim speeds, m/s, from the residuals of the service's kinematics (a quarter of it each)."""
    config, _ = robot_file(rojas_file(layout))
    estimate = config.robot.kinematics().twist([speed / WHEEL_RADIUS for speed in speeds], [None] * len(speeds))
    assert estimate is not None  # four wheels are three at least
    assert estimate.residuals is not None
    return 4.0 * (estimate.residuals[0] or 0.0)


def _real_slip(sample: Sample) -> list[float]:
    """Of each wheel, m/s: what it turns faster than it rolls."""
    c, s = cos(sample.heading), sin(sample.heading)
    rolls = rim_speeds(SYMMETRIC, c * sample.vx + s * sample.vy, -s * sample.vx + c * sample.vy, sample.wz)
    return [WHEEL_RADIUS * rate - speed for rate, speed in zip(sample.rates, rolls, strict=True)]
