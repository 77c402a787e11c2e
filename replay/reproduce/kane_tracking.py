"""Tracking of ASME Lett. Dyn. Sys. Control 2(4):040902, Figures 13 to 27: an omni robot whose wheels follow a path.

Directly: the paper's wheel control on the paper's dynamics (science 4 and 5), in its units. Through the service: a
commander that follows the same path by odometry.
"""

from collections.abc import Sequence
from math import cos, hypot, pi, sin

from gateway.types import Pose
from replay.reproduce.kane_model import (
    PRINTED_GAINS,
    WHEEL_GAINS,
    Force,
    Moment,
    Motion,
    Reference,
    Response,
    gains_for,
    poles,
    step_response,
    track,
)
from replay.reproduce.kane_robot import NEWTON, UNITS_NOTE, driven, seen_from_above
from replay.reproduce.picture import Level, Line, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_most, within
from replay.reproduce.service import Driven, Order
from replay.sim.plants.omni_parameters import INCH

NOT_PRINTED = "not printed"
SERVICE_NOTE = (
    "Through the service the wheels are under its own speed loops, with motors and gains that are ours, and whoever "
    "commands corrects the place with the odometry."
)
_CATCH_UP = 4.0  # 1/s, by which the commander corrects where the odometry tells the robot to be
_SIDE = 20.0  # in; printed (Eq. 26)
_ROUND = 25.0  # s, of a figure eight: the printed 5 does not fit "50 s" (science E-004-7)
_CORNERS = (5.0, 12.0)  # s; printed


def figure_13(stage: Stage) -> Found:
    """Figures 13 to 18, and the wheel control of section 2.4: twice round a figure eight."""
    stage.tell("wheel control")
    moments = track(figure_eight, seconds=2.0 * _ROUND)
    stage.tell("through the service")
    drive, beside = _follow(stage, figure_eight, 2.0 * _ROUND)
    rows = (
        *_pole_rows(),
        Row("largest torque", "slug in^2/s^2", _torque(moments), 0.6, "ref 0.577", at_most(0.6)),
        Row("largest error along n1", "in", max(abs(m.error_x) for m in moments), 0.0008, "", at_most(1e-3)),
        Row("largest error along n2", "in", max(abs(m.error_y) for m in moments), 0.001, "", at_most(1e-3)),
        Row("largest error of the spin", "rad", max(abs(m.spin) for m in moments), 6e-6, "", at_most(6e-6)),
        Row("largest distance from the path, service", "in", beside, None, "", at_most(0.2)),
    )
    panels = (
        (_map(figure_eight, 2.0 * _ROUND, moments, drive), _torques(moments)),
        (_errors(moments), _step_panel()),
        (_wheel_errors(moments), _wheel_speeds(moments)),
    )
    note = "The printed gains of wheels 1 and 2 have a wrong digit (1778.55 for 1178.55): their poles show it."
    return Found(
        rows,
        Picture("Figures 13 to 18: figure eight", panels),
        (note, UNITS_NOTE, SERVICE_NOTE),
        {"figure eight": drive.session},
    )


def figure_19(stage: Stage) -> Found:
    """Figures 15 and 19 to 22: two sharp corners at full speed."""
    stage.tell("wheel control")
    moments = track(sharp_corners, seconds=25.0)
    stage.tell("the same PID without a state")
    direct = track(sharp_corners, seconds=25.0, state_form=False)
    stage.tell("through the service")
    drive, beside = _follow(stage, sharp_corners, 25.0)
    rows = (
        Row("largest torque", "slug in^2/s^2", _torque(moments), 40.0, "20 to 40; ref 34.3", (20.0, 40.0)),
        Row("largest torque of the direct PID", "slug in^2/s^2", _torque(direct), None, "not to be used; ref 133"),
        Row("largest error of a wheel", "rad", _wheel_error(moments), None, "the paper: 5 to 10 %", at_most(0.1)),
        Row("largest error along n1", "in", max(abs(m.error_x) for m in moments), None, NOT_PRINTED),
        Row("largest error along n2", "in", max(abs(m.error_y) for m in moments), None, NOT_PRINTED),
        Row("largest distance from the path, service", "in", beside, None, "", at_most(0.5)),
    )
    panels = (
        (_map(sharp_corners, 25.0, moments, drive), _torques(moments)),
        (_errors(moments), _wheel_errors(moments)),
        (_velocities(drive),),
    )
    return Found(
        rows,
        Picture("Figures 15 and 19 to 22: sharp corners", panels),
        (
            "The second straight part of the way along n1 is 25 t/12 (inferred: it is continuous).",
            UNITS_NOTE,
            SERVICE_NOTE,
        ),
        {"sharp corners": drive.session},
    )


def figure_24(stage: Stage) -> Found:
    """Figures 23 to 27: the figure eight while somebody pushes."""
    stage.tell("wheel control")
    moments = track(figure_eight, seconds=2.0 * _ROUND, force=pushes)
    stage.tell("through the service")
    drive, beside = _follow(stage, figure_eight, 2.0 * _ROUND, force=pushes)
    rows = (
        Row("largest torque", "slug in^2/s^2", _torque(moments), 20.0, "ref 18.2", at_most(20.0)),
        Row("largest error of a wheel", "rad", _wheel_error(moments), 0.008, "ref 0.0089", at_most(0.009)),
        Row("largest error along n1", "in", max(abs(m.error_x) for m in moments), 0.06, "", at_most(0.06)),
        Row("largest error along n2", "in", max(abs(m.error_y) for m in moments), 0.04, "", at_most(0.06)),
        Row("largest error of the spin", "rad", max(abs(m.spin) for m in moments), 6e-6, "ref 2.1e-6", at_most(6e-6)),
        Row("largest distance from the path, service", "in", beside, None, "pushed along n1 alone", at_most(0.3)),
    )
    times = [0.01 * number for number in range(5001)]
    given = Panel(
        "Figure 23: pushes",
        "t [s]",
        "[slug in/s^2]",
        lines=tuple(Line(f"along n{i + 1}", times, [pushes(t)[i] for t in times], i) for i in range(2)),
    )
    panels = (
        (_map(figure_eight, 2.0 * _ROUND, moments, drive), given),
        (_errors(moments), _torques(moments)),
        (_wheel_errors(moments),),
    )
    return Found(
        rows,
        Picture("Figures 23 to 27: pushed", panels),
        (UNITS_NOTE, SERVICE_NOTE),
        {"pushed": drive.session},
    )


def figure_eight(t: float) -> Motion:
    """Eq. 26 with periods of 25 and 50 s."""
    found = []
    for rate in (2.0 * pi / _ROUND, pi / _ROUND):
        s, c = sin(rate * t), cos(rate * t)
        found.append((_SIDE * (1.0 - s), -_SIDE * rate * c, _SIDE * rate * rate * s))
    (x, vx, ax), (y, vy, ay) = found
    return Motion((x, y), (vx, vy), (ax, ay))


def sharp_corners(t: float) -> Motion:
    """Eqs. 27 and 28."""
    first, second = _CORNERS
    if t <= first:
        return Motion((5.0 * t, 25.0), (5.0, 0.0), (0.0, 0.0))
    if t <= second:
        return Motion((25.0, 25.0 + 5.0 * (t - first)), (0.0, 5.0), (0.0, 0.0))
    return Motion((25.0 * t / 12.0, 60.0), (25.0 / 12.0, 0.0), (0.0, 0.0))


def pushes(t: float) -> tuple[float, float]:
    """Eqs. 29 and 30, slug in/s^2."""
    return (
        10.0 * (4.0 <= t < 6.0) + 5.0 * (16.0 <= t < 20.0) + 8.0 * (26.0 <= t < 36.0),
        5.0 * (4.0 <= t < 6.0) + 10.0 * (16.0 <= t < 20.0) + 4.0 * (26.0 <= t < 36.0),
    )


def _follow(
    stage: Stage, reference: Reference, seconds: float, force: Force = lambda t: (0.0, 0.0)
) -> tuple[Driven, float]:
    """Driven along it, and the largest distance from where it should be, in, once it has caught up."""
    start = reference(0.0).place

    def order(t: float, pose: Pose) -> Order:
        motion = reference(t)
        missing = (motion.place[0] - start[0] - pose.x / INCH, motion.place[1] - start[1] - pose.y / INCH)
        vx, vy = (v + _CATCH_UP * way for v, way in zip(motion.velocity, missing, strict=True))
        return Order(vx * INCH, vy * INCH)

    drive = driven(stage, order, seconds, lambda loop, t: loop.bus.robot.set_push(force(t)[0] * NEWTON))
    distances = []
    for sample in drive.samples:
        wanted = reference(sample.t).place
        if sample.t >= 1.0:
            distances.append(hypot(sample.x / INCH + start[0] - wanted[0], sample.y / INCH + start[1] - wanted[1]))
    return drive, max(distances)


def _pole_rows() -> list[Row]:
    """Where the gains put the poles, of every wheel the one that is furthest off."""
    wanted, found = Response(), []
    for gains in WHEEL_GAINS:
        ours, inertia = gains_for(gains.derivative, wanted)
        placed = poles(gains, inertia)
        found.append((placed, ours))
    real = max((float(placed[0].real) for placed, _ in found), key=lambda pole: abs(pole + wanted.third))
    pairs = [placed[1] for placed, _ in found]
    part = max((float(pole.real) for pole in pairs), key=lambda pole: abs(pole + 8.0))
    swing = max((float(pole.imag) for pole in pairs), key=lambda pole: abs(pole - 4.0 * pi))
    first = WHEEL_GAINS[0]
    printed = poles(first._replace(proportional=PRINTED_GAINS[0]), gains_for(first.derivative, wanted)[1])
    return [
        Row("real pole of the wheel control", "1/s", real, None, "as placed: -100", within(-100.0, 0.1)),
        Row("real part of the other poles", "1/s", part, None, "as placed: -4/ts", within(-8.0, 0.008)),
        Row("imaginary part of them", "1/s", swing, None, "as placed: pi/tp", within(4.0 * pi, 0.001 * 4.0 * pi)),
        Row("real pole with the printed gain of wheel 1", "1/s", float(printed[0].real), None, "ref -87.5"),
        Row("Kprop of wheel 1", "slug in^2/s^2", first.proportional, PRINTED_GAINS[0], "a digit apart: 1178.55"),
    ]


def _torque(moments: Sequence[Moment]) -> float:
    return max(abs(torque) for moment in moments for torque in moment.torques)


def _wheel_error(moments: Sequence[Moment]) -> float:
    return max(abs(error) for moment in moments for error in moment.wheel_errors)


def _map(reference: Reference, seconds: float, moments: Sequence[Moment], drive: Driven) -> Panel:
    times = [0.02 * number for number in range(round(50.0 * seconds) + 1)]
    places = [reference(t).place for t in times]
    return seen_from_above(
        drive.samples,
        Line("wheel control", [m.x for m in moments], [m.y for m in moments]),
        Line("path", [p[0] for p in places], [p[1] for p in places], 7, dashed=True),
        start=places[0],
    )


def _torques(moments: Sequence[Moment]) -> Panel:
    return _of_wheels("Torques", "[slug in^2/s^2]", moments, [moment.torques for moment in moments])


def _errors(moments: Sequence[Moment]) -> Panel:
    times = [moment.t for moment in moments]
    return Panel(
        "Errors over the floor",
        "t [s]",
        "[in]",
        lines=(
            Line("along n1", times, [m.error_x for m in moments]),
            Line("along n2", times, [m.error_y for m in moments], 1),
        ),
    )


def _wheel_errors(moments: Sequence[Moment]) -> Panel:
    """Figures 17, 20 and 25."""
    return _of_wheels("Errors of the wheels", "[rad]", moments, [moment.wheel_errors for moment in moments])


def _wheel_speeds(moments: Sequence[Moment]) -> Panel:
    """Figure 14."""
    return _of_wheels("Wheels", "[rad/s]", moments, [moment.wheels for moment in moments])


def _of_wheels(title: str, unit: str, moments: Sequence[Moment], found: Sequence[Sequence[float]]) -> Panel:
    times = [moment.t for moment in moments]
    lines = tuple(Line(f"wheel {i + 1}", times, [one[i] for one in found], i) for i in range(4))
    return Panel(title, "t [s]", unit, lines=lines)


def _velocities(drive: Driven) -> Panel:
    """Figure 22 b."""
    times = [sample.t for sample in drive.samples]
    return Panel(
        "Figure 22 b: velocities, service",
        "t [s]",
        "[in/s]",
        lines=(
            Line("along n1", times, [s.vx / INCH for s in drive.samples]),
            Line("along n2", times, [s.vy / INCH for s in drive.samples], 1),
        ),
    )


def _step_panel() -> Panel:
    """Figure 5: a step of 0.05 rad."""
    times, angles = step_response(WHEEL_GAINS[0], gains_for(WHEEL_GAINS[0].derivative, Response())[1], 0.05)
    return Panel(
        "Figure 5: one wheel, a step of 0.05 rad",
        "t [s]",
        "[rad]",
        lines=(Line("wheel 1", times, angles),),
        levels=(Level("wanted", 0.05),),
    )
