"""Figure 10 and sections 7 and 8 of Rojas, Omnidirectional Control (2005): a motor at constant torque, and no slip.

The paper holds the robot and raises the voltage until wheels slip: V0. It starts with that, and adds the back-EMF of
the measured speed at each interval. Directly: the same on one motor, and on the robot's full dynamics over a floor that
gives so much. Through the service: its own launch, on the same robot and floor.
"""

from collections.abc import Callable, Sequence
from math import exp, inf
from pathlib import Path
from typing import NamedTuple

from gateway.chassis.omni import OmniRobot
from gateway.control.grip import Grip, part_of
from gateway.control.launch import stepped_voltage
from gateway.kinematics.forces import force_coupling, least_forces
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.omni_robot import drive_omni, robot_file
from replay.reproduce.picture import Level, Line, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_least, at_most, within
from replay.reproduce.rojas_robot import (
    DIRECT_MASS,
    DIRECT_RADIUS,
    MOTORS,
    SUPPLY,
    SYMMETRIC,
    WINDING,
    ahead,
    direct_drive_file,
    rim_speeds,
    towards,
)
from replay.reproduce.service import Driven, Sample
from replay.sim.controllers.contract import STEP_S
from replay.sim.controllers.dc_motor import DcMotor
from replay.sim.plants import plant_of
from replay.sim.plants.contract import PlantName
from replay.sim.plants.omni_dynamics import Stribeck

_START = 2.0  # V; printed
_TIME_CONSTANT = 0.05  # s; ours, as are motor and supply: figure 10 is of "a certain DC motor"
_MOST = 10.0  # V
_STAND_IN = DcMotor(resistance=2.83, constant=5.35e-3)  # Faulhaber 1331T006SR, of its data sheet
_INTERVALS = (0.02, 0.004, 0.001)  # s between two voltages
_FINE = 5e-4  # s between two points of a curve
_FLOOR = 0.3  # coefficient of friction
_FALLING = Stribeck(0.6, 0.1)  # of that at rest, left of it at much more than 0.1 m/s of slip, where it falls
_HEIGHT = 0.1  # m of the centre of mass, where loads are to shift
_TOP = 0.9  # m/s
_SLOW = 0.05  # m/s: of slower motion slip is no share
_EVERY = 0.004  # s between two voltages of the robot
_SECONDS = 0.9
_FALLING_SECONDS = 2.5  # of a plain ramp where friction falls
DIRECTIONS = {"forward": 90.0, "at 60 deg": 60.0, "diagonally": 45.0, "sideways": 0.0}


class Spinning(NamedTuple):
    """A motor: times, s; rates, rad/s; torques in parts of that of V0; voltages, V."""

    times: list[float]
    rates: list[float]
    torques: list[float]
    volts: list[float]


class Launched(NamedTuple):
    """A launch: times, s; speeds in its direction and the largest slip of a wheel, m/s."""

    times: list[float]
    speeds: list[float]
    slips: list[float]

    @property
    def acceleration(self) -> float:
        """m/s^2, between a fifth and four fifths of the speed; 0 if it does not come to that."""
        low, high = (
            next((t for t, v in zip(self.times, self.speeds, strict=True) if v >= part * _TOP), inf)
            for part in (0.2, 0.8)
        )
        return 0.6 * _TOP / (high - low) if high < inf else 0.0

    @property
    def seconds(self) -> float:
        """S to nine tenths of the speed; inf if it does not come to that."""
        return next((t for t, v in zip(self.times, self.speeds, strict=True) if v >= 0.9 * _TOP), inf)

    @property
    def slip(self) -> float:
        """The largest, in parts of the speed."""
        return max(slip / max(speed, _SLOW) for slip, speed in zip(self.slips, self.speeds, strict=True))


def figure_10(stage: Stage) -> Found:
    """One motor whose voltage follows its back-EMF, and the wheels of a robot that launches so."""
    stage.tell("one motor")
    stepped = {interval: _stepped(interval) for interval in _INTERVALS}
    middle = stepped[0.004]
    free = [_START * (1.0 - exp(-t / _TIME_CONSTANT)) / _STAND_IN.constant for t in middle.times]
    rates = [rate for rate, volts in zip(middle.rates, middle.volts, strict=True) if volts < _MOST]
    grown = rates[-1] / (len(rates) - 1) / _FINE * _STAND_IN.constant * _TIME_CONSTANT / _START
    stage.tell("through the service")
    drive = _driven(stage, 90.0, height=None, friction=_FLOOR)
    pushed = [s for s in drive.samples if 0.2 * _TOP < s.vx < 0.8 * _TOP]
    torques = [abs(s.torques[0]) for s in pushed]
    mean = sum(torques) / len(torques)
    rows = (
        Row("weakest torque at 4 ms", "of V0's", _weakest(middle), None, "e^(-0.08)", within(0.92312, 1e-5)),
        Row("strongest torque at 4 ms", "of V0's", max(middle.torques), None, "never above", at_most(1.0 + 1e-12)),
        Row("weakest torque at 1 ms", "of V0's", _weakest(stepped[0.001]), None, "e^(-0.02)", within(0.98020, 1e-5)),
        Row(
            "back-EMF at 4 ms from a straight line",
            "V",
            _bent(middle, 0.004),
            0.0,
            "k V0 (1 - e^(-0.08)) until it saturates",
            at_most(1e-12),
        ),
        Row("slope at 4 ms", "of V0/tau", grown, None, "1 where the voltage is changed ever more often", (0.94, 1.0)),
        Row("highest voltage", "V", max(middle.volts), None, "saturates at the supply, ours", within(_MOST, 1e-12)),
        Row(
            "torque of a wheel while launched, weakest, service",
            "of its mean",
            min(torques) / mean,
            None,
            "",
            (0.9, 1.0),
        ),
        Row("the same, strongest, service", "of its mean", max(torques) / mean, None, "", (1.0, 1.1)),
        Row(
            "wheel's speed from a straight line, service",
            "of its gain",
            _from_a_line([s.t for s in pushed], [s.rates[0] for s in pushed]),
            None,
            "between a fifth and four fifths of the speed",
            at_most(0.02),
        ),
    )
    coarse = stepped[0.02]
    speed = Panel(
        "One motor, V0 = 2 V, a new voltage every 20 ms",
        "t [s]",
        "[rad/s]",
        lines=(
            Line("stepped every 20 ms", coarse.times, coarse.rates),
            Line("ever more often", *_limit(coarse), 2, dashed=True),
            Line("2 V all the time", middle.times, free, 1, dashed=True),
            *(Line("", *curve, 7, dashed=True) for curve in _curves()),
        ),
        y_range=(0.0, 1.05 * max(coarse.rates)),
    )
    torque = Panel(
        "Its torque, in parts of that of V0",
        "t [s]",
        "",
        lines=tuple(
            Line(f"every {1e3 * interval:g} ms", one.times, one.torques, colour)
            for colour, (interval, one) in enumerate(stepped.items())
        ),
    )
    times = [s.t for s in drive.samples]
    wheels = Panel(
        "Launch forward, service: wheels",
        "t [s]",
        "[rad/s]",
        lines=tuple(Line(name, times, [s.rates[i] for s in drive.samples], i) for i, name in enumerate(MOTORS)),
    )
    driven = Panel(
        "Launch forward, service: torques",
        "t [s]",
        "[N m]",
        lines=tuple(Line(name, times, [s.torques[i] for s in drive.samples], i) for i, name in enumerate(MOTORS)),
    )
    notes = (
        "Inferred: figure 10 is of a motor that is not named, and its axes are not legible here. V0 = 2 V is printed; "
        f"motor (Faulhaber 1331T006SR), time constant ({1e3 * _TIME_CONSTANT:g} ms) and supply ({_MOST:g} V) are ours.",
        f"Service: {DIRECT_MASS:g} kg on four GM6020 motors in voltage mode and friction {_FLOOR} are ours.",
    )
    return Found(
        rows,
        Picture("Figure 10: constant torque by voltage steps", ((speed, torque), (wheels, driven))),
        notes,
        {"forward": drive.session},
    )


def launches(stage: Stage) -> Found:
    """From rest in four directions: the paper's voltage steps, all the voltage at once, and the service's launch."""
    rows, sessions = list[Row](), {}
    shown: dict[str, dict[str, Launched]] = {}
    for words, direction in DIRECTIONS.items():
        stage.tell(f"{words}: the paper's steps")
        even, shifting = (_best(direction, height) for height in (None, _HEIGHT))
        steps = {height: _launched(direction, height, _paper(direction)) for height in (None, _HEIGHT)}
        stage.tell(f"{words}: through the service")
        drive = _driven(stage, direction, height=_HEIGHT, friction=_FLOOR)
        ours = _seen(drive, direction)
        sessions[words] = drive.session
        shown[words] = {"steps, loads even": steps[None], "steps, loads shift": steps[_HEIGHT], "service": ours}
        rows += [
            Row(
                f"acceleration {words}, steps, loads even",
                "of the floor's best",
                steps[None].acceleration / even,
                None,
                f"best {even:.3g} m/s^2",
                (0.85, 1.0),
            ),
            Row(f"slip {words}, steps, loads even", "of the speed", steps[None].slip, 0.0, "", at_most(0.02)),
            Row(
                f"slip {words}, steps, loads shift",
                "of the speed",
                steps[_HEIGHT].slip,
                None,
                "the paper: even loads cannot be assumed",
            ),
            Row(
                f"acceleration {words}, loads shift, service",
                "of the floor's best",
                ours.acceleration / shifting,
                None,
                f"best {shifting:.3g} m/s^2",
                (0.95, 1.0),
            ),
            Row(f"slip {words}, loads shift, service", "of the speed", ours.slip, None, "", at_most(0.02)),
        ]
    stage.tell("forward: all the voltage at once")
    at_once = _launched(90.0, _HEIGHT, lambda _: [sign * SUPPLY for sign in (1.0, -1.0, -1.0, 1.0)])
    shown["forward"]["24 V at once"] = at_once
    stage.tell("forward: the service's plain ramp")
    drive = _driven(stage, 90.0, height=_HEIGHT, friction=None)
    plain, sessions["forward, plain ramp"] = _seen(drive, 90.0), drive.session
    rows += [
        Row("V0 of a robot that is held", "V", _start(), None, "with static loads; 2 V is that of the paper's robot"),
        Row("slip forward, 24 V at once", "of the speed", at_once.slip, None, "", at_least(0.5)),
        Row("slip forward, plain ramp, service", "of the speed", plain.slip, None, "9 m/s^2 asked for", at_least(0.5)),
    ]
    stage.tell("diagonally: friction that falls with slip")
    rows += _falling(stage, sessions)
    panels = [
        Panel(
            f"Speed {words}",
            "t [s]",
            "[m/s]",
            lines=tuple(Line(how, one.times, one.speeds, colour) for colour, (how, one) in enumerate(launched.items())),
            levels=(Level("", _TOP),),
        )
        for words, launched in shown.items()
    ]
    slips = [
        Panel(
            f"Slip of the worst wheel {words}",
            "t [s]",
            "[m/s]",
            lines=tuple(Line(how, one.times, one.slips, colour) for colour, (how, one) in enumerate(launched.items())),
            y_range=(0.0, 0.5),
        )
        for words, launched in shown.items()
        if words in {"forward", "sideways"}
    ]
    notes = (
        f"Inferred: the paper has no numbers here. {DIRECT_MASS:g} kg on four GM6020 motors, friction {_FLOOR}, centre "
        f"{_HEIGHT:g} m high where loads shift, and 4 ms between two voltages are ours.",
        "V0 is that of the wheel that pushes most; the others have less, in the proportions of section 5. The best is "
        "what the floor gives wheels with these loads.",
        "The paper's steps hold on even loads alone. Where acceleration shifts load, the wheels in front slip at "
        "the V0 of a robot that stands; the service shares torque by load and keeps a margin of 3 %.",
        "24 V at once is no slower here, as the friction of this floor does not fall with slip; but its wheels tell "
        "nothing of the way. Where it falls, to 60 % (Stribeck; numbers ours), wheels that slip are slower too.",
    )
    return Found(
        tuple(rows),
        Picture("Sections 7 and 8: launched without slip", (panels[:2], panels[2:], slips)),
        notes,
        sessions,
    )


def _falling(stage: Stage, sessions: dict[str, Path]) -> list[Row]:
    """Seconds to nine tenths of the speed with the launch and without, where friction falls with slip."""
    found: list[Launched] = []
    for how, friction in (("launch", _FLOOR), ("plain ramp", None)):
        drive = _driven(stage, 45.0, height=_HEIGHT, friction=friction, seconds=_FALLING_SECONDS, stribeck=_FALLING)
        sessions[f"friction that falls, {how}"] = drive.session
        found.append(_seen(drive, 45.0))
    careful, plain = found
    words = "friction falls with slip to 60 %"
    return [
        Row("time to 0.81 m/s diagonally, service", "s", careful.seconds, None, words, at_most(0.7)),
        Row("slip of that", "of the speed", careful.slip, None, "", at_most(0.02)),
        Row("time of a plain ramp, service", "of that", plain.seconds / careful.seconds, None, words, at_least(1.2)),
    ]


def _stepped(interval: float) -> Spinning:
    """The stand-in motor, a new voltage every `interval` s; exactly, its torque being an exponential between them."""
    motor, found = _STAND_IN, Spinning([], [], [], [])
    volts = back_emf = 0.0
    for number in range(round(0.4 / _FINE)):
        if number % round(interval / _FINE) == 0:
            volts = stepped_voltage(_START, back_emf, _MOST)
        found.times.append(number * _FINE)
        found.rates.append(back_emf / motor.constant)
        found.torques.append((volts - back_emf) / _START)
        found.volts.append(volts)
        back_emf += (volts - back_emf) * (1.0 - exp(-_FINE / _TIME_CONSTANT))
    return found


def _weakest(found: Spinning) -> float:
    """Torque at the end of an interval, before the voltage saturates."""
    share = exp(-_FINE / _TIME_CONSTANT)  # from the last point of an interval to its end
    return share * min(t for t, volts in zip(found.torques, found.volts, strict=True) if volts < _MOST)


def _bent(found: Spinning, interval: float) -> float:
    """The furthest that back-EMF is from growing evenly, at the ends of intervals before the voltage saturates."""
    every, gain = round(interval / _FINE), _START * (1.0 - exp(-interval / _TIME_CONSTANT))
    ends = [
        rate * _STAND_IN.constant
        for rate, volts in zip(found.rates[::every], found.volts[::every], strict=True)
        if volts < _MOST
    ]
    return max(abs(back_emf - number * gain) for number, back_emf in enumerate(ends))


def _limit(found: Spinning) -> tuple[list[float], list[float]]:
    """Times and rates of a torque that stays that of V0, as long as the voltage lasts."""
    slope, end = _START / _TIME_CONSTANT / _STAND_IN.constant, (_MOST - _START) * _TIME_CONSTANT / _START
    times = [t for t in found.times if t <= end]
    return times, [slope * t for t in times]


def _curves() -> list[tuple[list[float], list[float]]]:
    """How it would go on at each of the first voltages."""
    found, every = _stepped(0.02), round(0.02 / _FINE)
    curves = []
    for number in range(1, 6):
        first = number * every
        start, volts = found.rates[first - every], found.volts[first - every] / _STAND_IN.constant
        times = [step * 2.0 * _FINE for step in range(100)]
        rates = [volts + (start - volts) * exp(-t / _TIME_CONSTANT) for t in times]
        curves.append(([found.times[first - every] + t for t in times], rates))
    return curves


def _from_a_line(xs: Sequence[float], ys: Sequence[float]) -> float:
    """The furthest that points are off the line through first and last, in parts of what lies between these."""
    slope = (ys[-1] - ys[0]) / (xs[-1] - xs[0])
    return max(abs(y - ys[0] - slope * (x - xs[0])) for x, y in zip(xs, ys, strict=True)) / abs(ys[-1] - ys[0])


def _start() -> float:
    """V at which a wheel of the robot that is held slips."""
    return WINDING.voltage(_FLOOR * DIRECT_MASS * 9.81 / len(MOTORS) * DIRECT_RADIUS / WINDING.constant, 0.0)


def _paper(direction: float) -> Callable[[Sequence[float]], list[float]]:
    """Voltages for these back-EMFs: V0 for the wheel that pushes most, the others in the proportions of section 5."""
    robot = _robot(None)
    body, rims = robot.body, robot.kinematics().rim_matrix
    coupling = force_coupling(rims, ((body.mass, 0.0, 0.0), (0.0, body.mass, 0.0), (0.0, 0.0, body.inertia)))
    forces = least_forces(coupling, (*ahead(direction), 0.0), (True,) * len(MOTORS))
    assert forces is not None  # four wheels reach everything
    starts = [_start() * force / max(map(abs, forces)) for force in forces]
    return lambda back: [stepped_voltage(start, emf, SUPPLY) for start, emf in zip(starts, back, strict=True)]


def _launched(direction: float, height: float | None, volts: Callable[[Sequence[float]], list[float]]) -> Launched:
    """On the full dynamics, voltages told anew every 4 ms from the back-EMFs."""
    plant = plant_of(_robot(height), PlantName.DYNAMICS)
    for joint in plant.wheels:
        plant.set_friction(joint, _FLOOR)
    found, told = Launched([], [], []), [0.0] * len(MOTORS)
    x, y = ahead(direction)
    for number in range(round(_SECONDS / STEP_S)):
        if number % round(_EVERY / STEP_S) == 0:
            told = volts([WINDING.back_emf(rate) for rate in plant.rates])
        vx, vy, wz = plant.twist
        found.times.append(number * STEP_S)
        found.speeds.append(x * vx + y * vy)
        found.slips.append(_largest_slip(plant.rates, vx, vy, wz))
        if found.speeds[-1] >= _TOP:
            break
        plant.step([WINDING.torque(WINDING.current(volt, rate)) for volt, rate in zip(told, plant.rates, strict=True)])
    return found


def _driven(
    stage: Stage,
    direction: float,
    *,
    height: float | None,
    friction: float | None,
    seconds: float = _SECONDS,
    stribeck: Stribeck | None = None,
) -> Driven:
    """Through the service, whose robot file tells it of this friction, over a floor that gives what it gives here."""

    def slippery(loop: ClosedLoop, t: float) -> None:
        if t == 0.0:
            for name in MOTORS:
                loop.bus.robot.set_friction(name, _FLOOR)

    file = direct_drive_file(centre_height=height, friction=friction)
    return drive_omni(stage, file, lambda t, _: towards(direction, _TOP), seconds, slippery, stribeck=stribeck)


def _seen(drive: Driven, direction: float) -> Launched:
    x, y = ahead(direction)
    return Launched(
        [s.t for s in drive.samples],
        [x * s.vx + y * s.vy for s in drive.samples],
        [_slip_of(sample) for sample in drive.samples],
    )


def _slip_of(sample: Sample) -> float:
    """The heading hardly changes here: over the floor is along the body."""
    return _largest_slip(sample.rates, sample.vx, sample.vy, sample.wz)


def _largest_slip(rates: Sequence[float], vx: float, vy: float, wz: float) -> float:
    """Of a wheel, m/s."""
    rolled = rim_speeds(SYMMETRIC, vx, vy, wz)
    return max(abs(DIRECT_RADIUS * rate - speed) for rate, speed in zip(rates, rolled, strict=True))


def _best(direction: float, height: float | None) -> float:
    """m/s^2 that the floor gives in a direction."""
    robot = _robot(height)
    grip = Grip(
        robot.kinematics().rim_matrix,
        [(wheel.x, wheel.y) for wheel in robot.wheel],
        mass=robot.body.mass,
        inertia=robot.body.inertia,
        height=height or 0.0,
    )
    limits = [*(cone.limit for cone in grip.cones(_FLOOR)), *grip.lifting()]
    return 1.0 / part_of(limits, (*ahead(direction), 0.0))


def _robot(height: float | None) -> OmniRobot:
    robot = robot_file(direct_drive_file(centre_height=height, friction=None))[0].robot
    assert isinstance(robot, OmniRobot)  # that is its kind
    return robot
