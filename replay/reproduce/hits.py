"""Figure 15: both experiments of section 8. The robot goes 2 m forward and back, and is hit twice on its way back."""

from collections.abc import Sequence
from math import degrees
from typing import NamedTuple

from gateway.control.offset_law import GAIN
from gateway.types import Pose
from replay.reproduce import ideal
from replay.reproduce.ideal import Step, Velocity
from replay.reproduce.picture import Line, Mark, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, within
from replay.reproduce.robot import Setup
from replay.reproduce.service import Driven, Order, drive
from replay.reproduce.straight import NOT_PRINTED
from replay.sim.plants.offset_parameters import trailing

# All printed in section 8.
OFFSET = 0.145  # m, d1
PERIOD = 0.004  # s
SPEED = 0.05  # m/s
WAY = 2.0  # m
ACROSS = 0.5  # m/s
HITS = (10.0, 22.0)  # s from the turn back, the second to the other side
SECONDS = 32.0  # of the way back; ours
LAST_DIGIT = 0.06  # of figures with one decimal


class Test(NamedTuple):
    """One experiment. `figures`: heading of the chassis, deg, at a time from the turn back, s."""

    words: str
    gain: float
    hit: float  # s; printed
    figures: dict[float, float]


FREE = Test("uncompensated", 0.0, 0.4, {10.4: 64.8, 15.0: 144.3, 22.0: 176.7})
HELD = Test("compensated", 2.0, 0.8, {10.8: 77.8, 15.0: 21.5, 22.0: 1.94, 22.8: -77.6, 30.0: -7.7})


def figure_15(stage: Stage) -> Found:
    """Uncompensated the first hit flips the robot; compensated it is shoved as far, and comes back."""
    rows, panels, sessions = list[Row](), list[list[Panel]](), {}
    for test in (FREE, HELD):
        stage.tell(f"kinematics, {test.words}")
        steps = _kinematic(test)
        stage.tell(f"through the service, {test.words}")
        driven = _driven(test, stage)
        rows += _rows(test, steps, driven)
        panels.append(_panels(test, steps, driven))
        sessions[test.words] = driven.session
    notes = (
        "The paper prints the commands and no result in numbers: that the first hit was more than enough to turn the "
        "robot, and that the compensated one recovers its heading quickly.",
        "The paper's hits are commands. In the kinematics they are added behind the compensation, which does not know "
        "of them. Through the service they are commands while the gain is set to 0, and to 2 again behind "
        "them, because a compensated robot turns a command like any other, to the mirrored side: so nothing holds "
        "against a hit, and it turns the chassis by 10 degrees more.",
        "Radius and track of the real robot's wheels are not printed: 0.1 m and 0.4 m are ours, and no heading depends "
        "on them.",
    )
    columns = tuple(zip(*panels, strict=True))
    return Found(tuple(rows), Picture("Figure 15: hit twice on the way back", columns), notes, sessions)


def _across(t: float, test: Test) -> float:
    """Of the hits, m/s, at a time from the turn back."""
    for start, sign in zip(HITS, (1.0, -1.0), strict=True):
        if start - 1e-6 <= t < start + test.hit - 1e-6:
            return sign * ACROSS
    return 0.0


def _kinematic(test: Test) -> list[Step]:
    return ideal.drive(
        lambda t: Velocity(-SPEED, 0.0, hit=_across(t, test)),
        seconds=SECONDS,
        period=PERIOD,
        axle_offset=OFFSET,
        heading=0.0,
        gain=lambda _: test.gain,
    )


def _driven(test: Test, stage: Stage) -> Driven:
    setup = Setup(wheel_radius=0.1, axle_offset=OFFSET, track=0.4, rate=1.0 / PERIOD, gain=test.gain)
    forward, gain = WAY / SPEED, test.gain

    def order(t: float, _: Pose) -> Order:
        nonlocal gain
        if t < forward:
            return Order(SPEED, 0.0, 0.0)
        across = _across(t - forward, test)
        before, gain = gain, 0.0 if across else test.gain
        return Order(-SPEED, across, 0.0, {} if gain == before else {GAIN: gain})

    return drive(setup, order, stage, seconds=forward + SECONDS, heading=0.0, swivel=trailing(pulled=False))


def _rows(test: Test, steps: Sequence[Step], driven: Driven) -> list[Row]:
    found = []
    side = 1.0 if steps[round((HITS[0] + test.hit) / PERIOD)].heading > 0.0 else -1.0
    first = _back(driven, HITS[0] + test.hit)
    other = 1.0 if first > 0.0 else -1.0
    for t, figure in test.figures.items():
        words = f"heading at {t:g} s, {test.words}"
        ours = side * degrees(steps[round(t / PERIOD)].heading)
        note = f"kinematics, 4 ms; ref {figure:g}; {NOT_PRINTED}"
        found.append(Row(words, "deg", ours, None, note, within(figure, LAST_DIGIT)))
        found.append(Row(f"{words}, service", "deg", other * _back(driven, t), None, NOT_PRINTED))
    return found


def _back(driven: Driven, t: float) -> float:
    """Heading of the chassis at a time from the turn back, deg, from how it lies without a hit."""
    return degrees(driven.samples[round((WAY / SPEED + t) / PERIOD)].chassis)


def _panels(test: Test, steps: Sequence[Step], driven: Driven) -> list[Panel]:
    """Velocities above, headings below, as in the paper."""
    turn = WAY / SPEED
    times = [sample.t - turn for sample in driven.samples]
    marks = tuple(
        Mark(f"hits of {test.hit:g} s" if number == 0 else "", start, start + test.hit)
        for number, start in enumerate(HITS)
    )
    velocity = Panel(
        f"{test.words.capitalize()}: velocities",
        "t from the turn back [s]",
        "velocity [m/s]",
        lines=(
            Line("along x, service", times, [sample.vx for sample in driven.samples]),
            Line("along y, service", times, [sample.vy for sample in driven.samples], 1),
            Line("along y, kinematics", [step.t for step in steps], [step.vy for step in steps], 2, dashed=True),
        ),
        marks=marks,
    )
    heading = Panel(
        f"{test.words.capitalize()}: heading of the chassis",
        "t from the turn back [s]",
        "heading [deg]",
        lines=(
            Line("through the service", times, [degrees(sample.chassis) for sample in driven.samples]),
            Line("kinematics", [step.t for step in steps], [degrees(step.heading) for step in steps], 1, dashed=True),
        ),
        marks=marks,
    )
    return [velocity, heading]
