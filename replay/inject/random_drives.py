"""Random drives as scenarios: both sources, silences, requests, restarts, and every fault of the simulated world.

How this works
--------------
One number makes one drive, the same on every machine. `wild` drives break everything, in any order and at once, some
much and some little; `kind` drives keep the motors able to brake until the end, and end in silence for as long as the
robot needs to come to rest.
A robot that lies in FAULT keeps every law without effort: half of the faults are short losses from which it may go on,
often all commanders fall silent while it drives, and what goes wrong often does so soon after a start. Of encoders
mostly those fail that the geometry depends on. What a robot may forget with time shows in pauses in which nothing at
all happens, also after somebody has asked it to stand up.
"""

from collections.abc import Callable, Sequence
from random import Random
from typing import Any, NamedTuple

from gateway.config import RobotConfig
from gateway.types import Region
from replay.drive import faults
from replay.drive.faults import RULES, FaultKind, Target
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from replay.inject import laws

SECONDS = 16.0
SILENCE_S = 6.0  # at the end of a kind drive
ANSWERS_S = 0.3  # until motors are heard
PAUSE_S = (1.0, 14.0)  # beyond what anything in the robot waits for
Entry = dict[str, Any]

VALUES: dict[FaultKind, Callable[[Random], float]] = {
    FaultKind.ENCODER_JUMP: lambda chance: chance.choice([-1.0, 1.0]) * 10 ** chance.uniform(-2.0, 1.0),
    FaultKind.BRAKE_WEAK: lambda chance: chance.uniform(0.0, 0.8),
    FaultKind.ID_TWIN: lambda chance: chance.uniform(-3.0, 3.0),
    FaultKind.FRAMES_LOST: lambda chance: chance.uniform(0.05, 1.0),
    FaultKind.FRAMES_DELAYED: lambda chance: 10 ** chance.uniform(-2.5, -0.5),
    FaultKind.FRAMES_DOUBLED: lambda chance: chance.uniform(0.05, 1.0),
    FaultKind.SENSOR_JUMP: lambda chance: chance.choice([-1.0, 1.0]) * 10 ** chance.uniform(-2.5, 0.0),
    FaultKind.PUSH: lambda chance: chance.choice([-1.0, 1.0]) * 10 ** chance.uniform(1.5, 3.5),  # N, up to a collision
    FaultKind.SLOPE: lambda chance: chance.uniform(-0.12, 0.12),
    FaultKind.FRICTION: lambda chance: chance.uniform(0.02, 0.6),
    FaultKind.MASS: lambda chance: 10 ** chance.uniform(1.3, 3.7),  # up to what the motors hardly move
}
# Those that every plant knows.
ANY_FAULT = [kind for kind in FaultKind if RULES[kind].target not in (Target.CASTER, Target.SENSOR)]
SENSOR_FAULTS = [kind for kind in FaultKind if RULES[kind].target is Target.SENSOR]
MOST_KINDS = 4  # of faults in one drive of a campaign, besides short losses
PACES = (0.2, 0.5, 1.1)  # of a campaign: exponents of the longest time in which nothing happens, s
LOSSES = (FaultKind.POWER_OFF, FaultKind.POWER_CYCLE, FaultKind.CABLE_OUT, FaultKind.BUS_DOWN, FaultKind.LOOP_PAUSE)
ENCODERS = frozenset({FaultKind.ENCODER_FROZEN, FaultKind.ENCODER_JUMP})
ONLY_BRIEF = frozenset({FaultKind.PUSH, FaultKind.LOOP_PAUSE})
KIND_FAULTS = (FaultKind.LOOP_PAUSE, FaultKind.FRAMES_LOST, FaultKind.FRAMES_DELAYED, FaultKind.ENCODER_JUMP)
KIND_VALUES: dict[FaultKind, Callable[[Random], float]] = {
    FaultKind.FRAMES_LOST: lambda chance: chance.uniform(0.01, 0.15),
    FaultKind.FRAMES_DELAYED: lambda chance: chance.uniform(0.001, 0.008),
    FaultKind.ENCODER_JUMP: lambda chance: chance.uniform(-0.02, 0.02),
}


class Driven(NamedTuple):
    """What became of one drive: its cycles, and what broke each law."""

    cycles: int
    violations: dict[str, list[str]]


def drive(seed: int, config: RobotConfig, *, can_brake: bool) -> Driven:
    """The random drive of this number, and its violations of the laws."""
    return judge(scenario(seed, config, can_brake=can_brake), config, can_brake=can_brake)


def judge(script: Scenario, config: RobotConfig, *, can_brake: bool) -> Driven:
    """Drive this one."""
    moments: list[Moment] = []
    run_scenario(script, config, watch=moments.append)
    return Driven(len(moments), laws.violations(moments, config, can_brake=can_brake))


def scenario(seed: int, config: RobotConfig, *, can_brake: bool) -> Scenario:
    """The script: it begins well, so that most drives do drive."""
    chance = Random(seed)
    lively = SECONDS - SILENCE_S if can_brake else SECONDS
    entries = [*_upright(config, ANSWERS_S), _command(chance, config, 0.0, still=True)]
    trouble = chance.choice([0.7, 2.0, 4.0])
    t = ANSWERS_S + 0.5
    while t < lively:
        some, t = _something(chance, config, t, trouble=trouble, can_brake=can_brake)
        entries += some
        t += 10 ** chance.uniform(-1.5, 0.2)
    entries = [entry for entry in entries if entry["t"] < lively]  # what follows a start or a hush may be too late
    if can_brake:
        entries += [{"t": lively, "silence": source.name} for source in config.commands.source]
    return Scenario.model_validate(
        {"robot": config.robot.name, "seconds": SECONDS, "seed": seed, "at": sorted(entries, key=lambda at: at["t"])}
    )


def happenings(chance: Random, config: RobotConfig, seconds: float) -> list[Entry]:
    """What goes wrong in a drive of so many seconds that somebody commands already.

    Each drive has a pace of its own and only a few kinds of faults: what takes two of a kind, or a long time in which
    nothing happens, hardly ever comes about where everything happens all the time (swarm testing).
    """
    trouble, longest = chance.choice([0.7, 2.0, 4.0]), chance.choice(PACES)
    some = chance.sample(_all_kinds(config), chance.randint(1, MOST_KINDS))
    entries: list[Entry] = []
    t = 10 ** chance.uniform(-1.5, longest)
    while t < seconds:
        more, t = _something(chance, config, t, trouble=trouble, can_brake=False, kinds=some)
        entries += more
        t += 10 ** chance.uniform(-1.5, longest)
    return sorted([entry for entry in entries if entry["t"] < seconds], key=lambda at: at["t"])


def _something(
    chance: Random,
    config: RobotConfig,
    t: float,
    *,
    trouble: float,
    can_brake: bool,
    kinds: Sequence[FaultKind] | None = None,
) -> tuple[list[Entry], float]:
    """What happens, and until when nothing else does."""
    happenings = {"command": 6.0, "start": 3.0, "silence": 1.0, "hush": 1.5, "request": 1.0, "fault": trouble}
    happenings |= {} if can_brake else {"pause": 0.5}
    kind = chance.choices(list(happenings), list(happenings.values()))[0]
    if kind == "pause":
        return _pause(chance, config, t)
    if kind == "start":
        begun = _start(chance, config, t)
        if not can_brake and chance.random() < 0.5:
            begun.append({"t": t + chance.uniform(0.5, 2.0), "fault": _fault(chance, config, kinds)})
        return begun, t
    return _one(kind, chance, config, t, can_brake=can_brake, kinds=kinds), t


def _one(
    kind: str, chance: Random, config: RobotConfig, t: float, *, can_brake: bool, kinds: Sequence[FaultKind] | None
) -> list[Entry]:
    if kind == "command":
        return [_command(chance, config, t, still=chance.random() < 0.15)]
    if kind == "silence":
        return [{"t": t, "silence": chance.choice(config.commands.source).name}]
    if kind == "hush":
        again = _command(chance, config, t + chance.uniform(0.1, 1.0), still=False)
        return [*_hush(config, t), again] if can_brake else [*_hush(config, t), *_loss_while_braking(chance, t), again]
    if kind == "request":
        words = ["estop", "reset", "reset", "reference"] if can_brake else ["estop", "reset", "reference", "restart"]
        words += ["stand_up", "stand_up", "let_down", "let_down"] if _upright(config, t) else []
        return [{"t": t, "request": chance.choice(words)}]
    return [{"t": t, "fault": _kind_fault(chance) if can_brake else _fault(chance, config, kinds)}]


def _start(chance: Random, config: RobotConfig, t: float) -> list[Entry]:
    """What most people do when the robot does not move."""
    sources = config.commands.source if chance.random() < 0.8 else [chance.choice(config.commands.source)]
    zeros = [_command(chance, config, t, still=True, source=source.name) for source in sources]
    reset: list[Entry] = [{"t": t, "request": "reset"}] if chance.random() < 0.8 else []
    return [*reset, *_upright(config, t), *zeros, _command(chance, config, t + chance.uniform(0.1, 0.5), still=False)]


def _pause(chance: Random, config: RobotConfig, t: float) -> tuple[list[Entry], float]:
    """Everybody goes away, and somebody comes back and drives, without asking for anything first; until then."""
    again = t + chance.uniform(*PAUSE_S)
    source = chance.choice(config.commands.source).name
    zero = _command(chance, config, again, still=True, source=source)
    more = _command(chance, config, again + chance.uniform(0.1, 0.5), still=False, source=source)
    return [*_hush(config, t), *_upright(config, t), zero, more], again


def _hush(config: RobotConfig, t: float) -> list[Entry]:
    return [{"t": t, "silence": source.name} for source in config.commands.source]


def _upright(config: RobotConfig, t: float) -> list[Entry]:
    """Somebody holds a robot that balances, and asks it to stand up."""
    return [{"t": t, "request": "stand_up"}] if getattr(config.robot, "balance", None) is not None else []


def _loss_while_braking(chance: Random, t: float) -> list[Entry]:
    """The bus goes, sometimes, while the robot is on its way to rest."""
    if chance.random() < 0.5:
        return []
    fault = {"kind": FaultKind.BUS_DOWN.value, "seconds": chance.uniform(0.02, 0.8)}
    return [{"t": t + chance.uniform(0.2, 1.0), "fault": fault}]


def _command(chance: Random, config: RobotConfig, t: float, *, still: bool, source: str | None = None) -> Entry:
    axis = [0.0 if still or chance.random() < 0.3 else chance.uniform(-1.3, 1.3) for _ in range(3)]
    vx, vy, wz = (part * top for part, top in zip(axis, config.limits.velocity.as_twist(), strict=True))
    rate = chance.choice([20.0, 50.0, 100.0, 3.0]) if not still else 50.0
    source = source or chance.choices(config.commands.source, [3, 1])[0].name
    stamped = chance.random() < 0.5
    command = {"source": source, "vx": vx, "vy": vy, "wz": wz, "rate": rate, "stamped": stamped}
    if chance.random() < 0.1:
        command["sender"] = "stranger"
    if not still and "width_rate" in config.robot.AXES:
        command |= _width(chance, config)
    if getattr(config.robot, "manoeuvre", None) is not None:
        command["region"] = chance.choice(list(Region)).value
    return {"t": t, "command": command}


def _width(chance: Random, config: RobotConfig) -> Entry:
    """A rate, a width, sometimes beyond the range, or neither."""
    narrowest, widest = (getattr(config.robot, key) for key in ("narrowest", "widest"))
    (top,) = config.limits.velocity.as_rates(config.robot.AXES)[3:]
    given = {"width_rate": chance.uniform(-1.3, 1.3) * top, "width": chance.uniform(0.9 * narrowest, 1.1 * widest)}
    key = chance.choice(["width_rate", "width", None])
    return {} if key is None else {key: given[key]}


def _all_kinds(config: RobotConfig) -> list[FaultKind]:
    return [*ANY_FAULT, *(SENSOR_FAULTS if faults.sensors(config) else ())]


def _fault(chance: Random, config: RobotConfig, kinds: Sequence[FaultKind] | None) -> Entry:
    """One of these kinds, or of all, or a short loss."""
    brief = chance.random() < 0.5
    sensing = faults.sensors(config)
    kind = chance.choice(LOSSES if brief else kinds or _all_kinds(config))
    rule = RULES[kind]
    fault: Entry = {"kind": kind.value}
    if rule.target is Target.MOTOR and (kind is not FaultKind.CLEAR or chance.random() < 0.3):
        names = config.robot.motor_names()
        steered = [names[index] for index in config.robot.kinematics().steered]
        fault["motor"] = chance.choice(steered if steered and kind in ENCODERS and chance.random() < 0.7 else names)
    if rule.target is Target.SENSOR:
        fault["sensor"] = chance.choice(sensing)
    if kind in VALUES:
        fault["value"] = VALUES[kind](chance)
    if rule.timed or (rule.end is not None and (brief or chance.random() < 0.7)):
        fault["seconds"] = 10 ** chance.uniform(-2.0, -0.2 if kind in ONLY_BRIEF else 0.5)
    return fault


def _kind_fault(chance: Random) -> Entry:
    kind = chance.choice(KIND_FAULTS)
    fault: Entry = {"kind": kind.value, "seconds": 10 ** chance.uniform(-2.0, -0.5)}
    if kind is FaultKind.ENCODER_JUMP:
        del fault["seconds"]
    if kind in KIND_VALUES:
        fault["value"] = KIND_VALUES[kind](chance)
    return fault
