"""From a recorded drive to the parameters of the simulated robot: fitted, then fitted again beside its own likeness.

How this works
--------------
Torques needed for the measured motion, by the plant's own equations, are fitted to the torques told. Measuring itself
shifts the result a little: humps blunt corners, numbers come in steps, and a torque that an ODrive tells ten times a
second always meets the same moment between two commands, at which its speed loop pushes more or less than on average.
So the same commands are driven once more on the simulated robot with what was found, the same numbers are taken from
that drive, and what is left over there, where nothing but the measuring can be the cause, is taken off (indirect
inference; Gourieroux, Monfort and Renault 1993). That drive has no noise either, so its motion is the instrument of the
fit: what did not move in it was not moved. That is done `ROUNDS` times.

A torque told counts as true: nothing in a drive says whether a robot of twice the mass has motors of twice the torque
constant. Where a mass is known, it is the torque constant that is found.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.config import RobotConfig
from replay.identify import models
from replay.identify.driven import Drive, driven, plant_with, recorded
from replay.identify.fit import IMPOSSIBLE, Estimate, Fit, Problem, fit
from replay.identify.measured import Series, measured
from replay.identify.moments import Moments, moments
from replay.identify.parameters import (
    PARAMETERS,
    TORQUE_SCALE,
    Found,
    IdentifyError,
    ParameterFile,
    Refused,
    RobotSection,
    names_for,
    values_of,
    with_values,
)
from replay.sessions.reader import Session
from replay.sim.plants import plant_of
from replay.sim.plants.contract import PlantName

Array = NDArray[np.float64]

ROUNDS = 2
ABRUPT = 0.15  # of a motor's torque (rms), by which a torque may change within a hump where it is told seldom
NOTICED = 0.01  # of the largest torque of the motors: less drag no joint notices
ALIKE = 0.2  # of a motor's torque (rms), within which likeness and drive need the same at an instant
ENOUGH = 0.3  # of the instants at which they must, for the drive to be held against its likeness
HELD = "it was given"
KNOWN_MASS = "a torque told counts as true unless a mass is given (--known mass=KG): only their ratio shows in a drive"


class Identified(NamedTuple):
    """What came of it. For a picture: instants (s), N m told and needed at them (motors, n).

    `likeness`: how often the drive could be held against its likeness; `slipping`, `abrupt`: instants left out.
    """

    file: ParameterFile
    motors: Sequence[str]
    at: Array
    told: Array
    needed: Array
    likeness: int
    slipping: int
    abrupt: int


class _Look(NamedTuple):
    """A drive as it is looked at: the fit's problem, and the instants."""

    problem: Problem
    moments: Moments
    abrupt: int
    needs: models.Forces


def identify(
    session: Session, *, plant: PlantName | None = None, known: Mapping[str, float] | None = None
) -> Identified:
    """All of it. `plant`: by which; None: the session's own, or else the one that leaves less over.

    `known`: parameters that are not sought. Raises SessionError, ConfigError, IdentifyError.
    """
    drive = recorded(session)
    given = dict(known or {})
    _check_known(drive.config, given)
    chosen = plant or drive.plant
    wanted = models.plants_of(drive.config.robot.kind) if chosen is None else [chosen]
    series = measured((inputs for inputs, _ in session.cycles()), drive.config)
    candidates, problems = [], []
    for one in wanted:
        try:
            candidates.append(_identified(drive, series, one, given))
        except IdentifyError as error:
            problems.append(error)
    if not candidates:
        raise problems[0] if problems else IdentifyError(f"kind {drive.config.robot.kind} cannot be identified")
    return min(candidates, key=_fits)


def _fits(found: Identified) -> tuple[int, float]:
    """The less the better: parameters that cannot be, and what is mostly left over, of the torque of each motor."""
    impossible = sum(one.reason.startswith(IMPOSSIBLE) for one in found.file.not_found.values())
    sizes = np.sqrt(np.nanmean(found.told**2, axis=1))
    return impossible, float(np.mean(np.nanmedian(np.abs(found.needed - found.told), axis=1) / sizes))


def _identified(drive: Drive, series: Sequence[Series], plant: PlantName, given: Mapping[str, float]) -> Identified:
    robot = with_values(drive.config.robot, given)
    look = _look(robot, series, plant, given)
    found = fit(look.problem, partial(_reason, look))
    likeness = 0
    for _ in range(ROUNDS):
        again = _likeness(drive, series, plant, look, _values(robot, given, found))
        if again is None:
            break
        likeness += 1
        problem = look.problem._replace(told=look.problem.told - again.left, instruments=again.instruments)
        found = fit(problem, partial(_reason, look))
    return _answer(drive, plant, given, look, found, likeness)


def _look(robot: RobotSection, series: Sequence[Series], plant: PlantName, given: Mapping[str, float]) -> _Look:
    """Everything that the fit needs, in torques of the joints."""
    try:
        plant_of(robot, plant)
        needs = models.forces(robot, plant)
    except ValueError as error:
        raise IdentifyError(str(error)) from None
    rows, values = models.rows(robot), values_of(robot) | dict(given)
    at = moments(series, rows, models.radius(robot))
    base = needs(robot, at.motion)
    at, abrupt = _not_abrupt(at, _joints(rows) @ base)
    names = [name for name in names_for(robot) if name not in given and name != TORQUE_SCALE]
    columns = _columns(needs, robot, names, at)
    rest = at.weighed(_joints(rows) @ base) - np.tensordot([values[name] for name in names], columns, axes=1)
    scaled = TORQUE_SCALE if "mass" in given and TORQUE_SCALE not in given else None
    told = _told(rows, at) * given.get(TORQUE_SCALE, 1.0)
    if scaled:
        names, columns = [*names, scaled], np.concatenate((columns, -told[None]))
    problem = Problem(
        names,
        np.array([values[name] for name in names]),
        np.array([_noticed(name, values[name], told, at) for name in names]),
        np.array([PARAMETERS[name].least for name in names]),
        columns,
        rest,
        told,
        at.at,
        columns,
        scaled,
    )
    return _Look(problem, at, abrupt, needs)


def _columns(needs: models.Forces, robot: RobotSection, names: Sequence[str], at: Moments) -> Array:
    """N m of each joint by one of each parameter: exact, as every force is linear in them."""
    joints, base, values = _joints(models.rows(robot)), needs(robot, at.motion), values_of(robot)
    found = []
    for name in names:
        more = max(abs(values[name]), 0.1)
        changed = with_values(robot, {name: values[name] + more})
        found.append(at.weighed(joints @ (needs(changed, at.motion) - base)) / more)
    return np.array(found)


def _joints(rows: Array) -> Array:
    """Torques of the joints, the least ones, that give a force along the three speeds: (motors, 3)."""
    return rows @ np.linalg.inv(rows.T @ rows)


def _told(rows: Array, at: Moments) -> Array:
    """Without what only strains the robot, of more than three wheels."""
    return at.told if rows.shape[0] == rows.shape[1] else _joints(rows) @ rows.T @ at.told


def _not_abrupt(at: Moments, need: Array) -> tuple[Moments, int]:
    """Where torques are told seldom: without the instants around which they change too fast for that."""
    if not at.sparse:
        return at, 0
    most = ABRUPT * np.sqrt(np.mean(need * need, axis=1, keepdims=True))
    abrupt = np.any(at.abrupt(need) > most, axis=0)
    if np.count_nonzero(~abrupt) < 2:
        raise IdentifyError("torques are told too seldom for a drive as abrupt as this one")
    return at.without(abrupt), int(np.count_nonzero(abrupt))


def _noticed(name: str, value: float, told: Array, at: Moments) -> float:
    """How much of a parameter is worth telling, so that one may be zero."""
    least = NOTICED * float(np.nanmax(np.abs(told)))
    rates = float(np.max(np.abs(at.motion.rates)))
    return max(value, {"joint_drag": least, "joint_friction": least / rates}.get(name, 1e-6))


class _Likeness(NamedTuple):
    """`left`: N m told less needed, in the same drive of the simulated robot. NaN where that goes another way."""

    left: Array
    instruments: Array


def _likeness(
    drive: Drive, series: Sequence[Series], plant: PlantName, look: _Look, values: Mapping[str, float]
) -> _Likeness | None:
    """None where it mostly goes another way."""
    robot, problem = with_values(drive.config.robot, values), look.problem
    cycles = driven(
        drive,
        plant_with(drive.config.robot, plant, values),
        torque_scale=values[TORQUE_SCALE],
        angles=begin_angles(series),
    )
    again = measured((inputs for inputs, _ in cycles), drive.config)
    rows = models.rows(robot)
    try:
        at = moments(again, rows, models.radius(robot), look.moments)
    except IdentifyError:
        return None
    need_then = look.moments.weighed(_joints(rows) @ look.needs(robot, look.moments.motion))
    need = at.weighed(_joints(rows) @ look.needs(robot, at.motion))
    most = ALIKE * np.sqrt(np.mean(need_then * need_then, axis=1, keepdims=True))
    alike, told = np.abs(need - need_then) < most, _told(rows, at)
    known = np.isfinite(problem.told)
    if np.count_nonzero(alike & known & np.isfinite(told)) < ENOUGH * np.count_nonzero(known):
        return None
    instruments = _columns(look.needs, robot, [name for name in problem.names if name != TORQUE_SCALE], at)
    if problem.scale_of_torques:
        instruments = np.concatenate((instruments, -told[None]))
    return _Likeness(np.where(alike, told - need / values[TORQUE_SCALE], np.nan), instruments)


def begin_angles(series: Sequence[Series]) -> dict[str, float]:
    """rad of each joint when the drive began."""
    return {one.name: float(one.angles[0]) for one in series if one.angles.size}


def _values(robot: RobotSection, given: Mapping[str, float], found: Fit) -> dict[str, float]:
    """All of them: found, given, or of the robot file; none below what there can be."""
    sought = {name: max(one.value, PARAMETERS[name].least) for name, one in found.found.items()}
    return values_of(robot) | dict(given) | sought


def _reason(look: _Look, name: str, twin: str | None) -> str:
    """Why the drive does not tell it."""
    if twin is not None:
        return f"this drive does not tell it from {twin}: only both together show"
    changes = look.moments.weighed(look.moments.motion.changes)
    turning = float(np.sqrt(np.mean(changes[-1] ** 2)))
    if name in {"inertia", "chassis_inertia"}:
        return f"the robot hardly changed its turning (rms {turning:.2g} rad/s^2): it resists nothing else"
    if name in {"mass", "joint_inertia"}:
        return f"the robot hardly changed its speed (rms {float(np.sqrt(np.mean(changes[0] ** 2))):.2g} m/s^2)"
    return "it is lost in what the other parameters and the noise leave over"


def _check_known(config: RobotConfig, known: Mapping[str, float]) -> None:
    names = names_for(config.robot)
    for name, value in known.items():
        if name not in names:
            raise IdentifyError(f"--known {name}: must be one of {', '.join(names)}")
        if not PARAMETERS[name].least <= value < float("inf"):
            raise IdentifyError(
                f"--known {name} = {value:g}: must be {PARAMETERS[name].least:g} or more {PARAMETERS[name].unit}"
            )


def _answer(  # noqa: PLR0917  # all that was found
    drive: Drive, plant: PlantName, given: Mapping[str, float], look: _Look, found: Fit, likeness: int
) -> Identified:
    motors = drive.config.robot.motor_names()
    names, values = names_for(drive.config.robot), values_of(drive.config.robot)
    refused = {name: Refused(values[name], reason) for name, reason in found.refused.items()}
    refused |= {name: Refused(value, HELD) for name, value in given.items()}
    if TORQUE_SCALE not in (*found.found, *refused):
        refused[TORQUE_SCALE] = Refused(1.0, KNOWN_MASS)
    off = np.sqrt(np.nanmean((found.model - found.told) ** 2, axis=1))
    size = np.sqrt(np.nanmean(found.told**2, axis=1))
    file = ParameterFile(
        robot=drive.config.robot.name,
        kind=drive.config.robot.kind,
        session=drive.name,
        plant=plant.value,
        found={name: _found(name, found.found[name]) for name in names if name in found.found},
        not_found={name: refused[name] for name in names if name in refused},
        residuals={motor: float(one) for motor, one in zip(motors, off, strict=True)},
        torques={motor: float(one) for motor, one in zip(motors, size, strict=True)},
        seconds=round(drive.cycles / drive.config.loop.rate, 3),
        moments=len(look.problem.times),
    )
    at = look.problem.times
    return Identified(file, motors, at, found.told, found.model, likeness, look.moments.slipping, look.abrupt)


def _found(name: str, one: Estimate) -> Found:
    """Nothing below what there can be."""
    least = PARAMETERS[name].least
    value, low, high = (max(least, number) for number in (one.value, one.value - one.half, one.value + one.half))
    return Found(value, low, high, PARAMETERS[name].unit)
