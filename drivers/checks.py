"""Checks that every driver makes of the motors it is given, and the one rule for when feedback is too old."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import combinations
from math import inf
from re import fullmatch
from typing import Final, NamedTuple

from drivers.contract import IdUse, MotorSpec, OptionValue
from drivers.setpoint import MotorCommand

MIN_FEEDBACK_TIMEOUT_NS: Final = 50_000_000
FEEDBACK_TIMEOUT_PERIODS: Final = 5
SLOWEST_FEEDBACK_HZ: Final = 10.0  # five periods are 0.5 s; a motor that is silent for longer must have been given up
FASTEST_FEEDBACK_HZ: Final = 1000.0
WATCHDOG_PERIODS: Final = 3.0  # of the loop: one frame may be lost and the next one late
LONGEST_WATCHDOG_S: Final = 1.0

STANDARD_IDS: Final = 0x7FF
EXTENDED_IDS: Final = 0x1FFF_FFFF


class Bound(NamedTuple):
    """The range of one number of a motor that a protocol can work with, and why."""

    key: str
    value: float
    low: float
    high: float
    unit: str
    why: str


class Option(NamedTuple):
    """One key of a driver's own `options`: which values it takes, and the same in words."""

    takes: Callable[[OptionValue], bool]
    allowed: str


def check_specs(
    motors: Sequence[MotorSpec], *, driver: str, variants: Sequence[str], ids: range, cyclic: bool = True
) -> None:
    """Raise ValueError for no motor, an unknown variant, an id out of range or given twice, a number out of range.

    `cyclic`: whether the controllers send their feedback on their own, or only in reply to commands.
    """
    if not motors:
        raise ValueError(f"driver {driver}: needs at least one motor")
    owners: dict[int, str] = {}
    for motor in motors:
        if motor.variant not in variants:
            allowed = ", ".join(variants)
            raise ValueError(f"motor {motor.name}: variant = {motor.variant!r}: driver {driver} knows {allowed}")
        if motor.id not in ids:
            raise ValueError(f"motor {motor.name}: id = {motor.id}: must be {ids[0]} to {ids[-1]} for {motor.variant}")
        if motor.id in owners:
            raise ValueError(f"motor {motor.name}: id = {motor.id}: already the id of motor {owners[motor.id]}")
        owners[motor.id] = motor.name
        check_bounds(motor, _common_bounds(motor))
        _check_feedback_rate(motor, cyclic=cyclic)


def check_bounds(motor: MotorSpec, bounds: Iterable[Bound]) -> None:
    """Raise ValueError for the first number out of its range; NaN is in none."""
    for key, value, low, high, unit, why in bounds:
        if not low <= value <= high:
            raise ValueError(f"motor {motor.name}: {key} = {value:.6g}: must be {_range(low, high, unit)}: {why}")


def check_count(commands: Sequence[MotorCommand], motors: Sequence[object]) -> None:
    """Raises ValueError unless there is one command for each motor."""
    if len(commands) != len(motors):
        raise ValueError(f"{len(commands)} commands: must be one for each of {len(motors)} motors")


NO_OPTIONS: Final[Mapping[str, Option]] = {}


def check_options(
    motor: MotorSpec, needed: Mapping[str, Option], *, of: str, optional: Mapping[str, Option] = NO_OPTIONS
) -> None:
    """Raise ValueError for an option that is unknown, missing or not allowed. `of`: whose options, in words."""
    known = {**needed, **optional}
    for key, value in motor.options.items():
        where = f"motor {motor.name}: options.{key} = {value!r}"
        if key not in known:
            may = f" may have {', '.join(optional)}, and" if optional else ""
            raise ValueError(f"{where}: no such option; {of}{may} has {', '.join(needed) or 'none'}")
        if not known[key].takes(value):
            raise ValueError(f"{where}: must be {known[key].allowed}")
    for key, option in needed.items():
        if key not in motor.options:
            raise ValueError(f"motor {motor.name}: options.{key} is missing: must be {option.allowed}")


def whole_number(low: int, high: int, meaning: str) -> Option:
    """An option that is an integer of this range."""
    return Option(lambda value: type(value) is int and low <= value <= high, f"{low} to {high}, {meaning}")


def one_of(words: Iterable[str], meaning: str) -> Option:
    """An option that is one of these."""
    known = tuple(words)
    return Option(lambda value: value in known, f"{' or '.join(map(repr, known))}, {meaning}")


def text(pattern: str, meaning: str) -> Option:
    """An option whose whole text matches this pattern."""
    return Option(lambda value: isinstance(value, str) and fullmatch(pattern, value) is not None, meaning)


def _range(low: float, high: float, unit: str) -> str:
    return f"at least {low:.6g} {unit}" if high == inf else f"{low:.6g} to {high:.6g} {unit}"


def _common_bounds(motor: MotorSpec) -> list[Bound]:
    bounds = [
        # The least numbers only keep the arithmetic of the wire away from denormals.
        Bound("max_speed", motor.max_speed, 1e-6, 1e9, "rad/s at the motor shaft", "a motor that can turn"),
        Bound("max_torque", motor.max_torque, 1e-9, 1e9, "N m at the motor shaft", "a motor that can push"),
        Bound("max_current", motor.max_current, 1e-3, 1e6, "A", "a motor that can push"),
    ]
    if motor.watchdog_s is not None:
        why = f"{WATCHDOG_PERIODS:g} periods of loop.rate = {motor.command_rate:g} Hz, so that a lost frame is survived"
        shortest = WATCHDOG_PERIODS / motor.command_rate
        bounds.append(Bound("watchdog.timeout", motor.watchdog_s, shortest, LONGEST_WATCHDOG_S, "s", why))
    return bounds


def _check_feedback_rate(motor: MotorSpec, *, cyclic: bool) -> None:
    rate, low, high = motor.feedback_rate, SLOWEST_FEEDBACK_HZ, FASTEST_FEEDBACK_HZ
    periods = FEEDBACK_TIMEOUT_PERIODS
    silence = f"a motor counts as silent after {periods} periods, and must by {periods / low:g} s"
    if rate is not None and not cyclic:
        why = f"a {motor.variant} only replies to commands"
        raise ValueError(f"motor {motor.name}: feedback_rate = {rate:.6g}: must be left out: {why}")
    if rate is None and cyclic:
        allowed = f"must be {_range(low, high, 'Hz')}, as configured in the controller: {silence}"
        raise ValueError(f"motor {motor.name}: feedback_rate is missing: {allowed}")
    if rate is not None:
        check_bounds(motor, [Bound("feedback_rate", rate, low, high, "Hz", silence)])


def measuring_hz(motor: MotorSpec) -> float:
    """How often the controller tells its measurements: on its own, or in reply to each command."""
    return motor.command_rate if motor.feedback_rate is None else motor.feedback_rate


def feedback_timeout_ns(motor: MotorSpec) -> int:
    """How long its measurements may be missing before the motor counts as silent."""
    return max(MIN_FEEDBACK_TIMEOUT_NS, int(FEEDBACK_TIMEOUT_PERIODS * 1e9 / measuring_hz(motor)))


def id_conflicts(drivers: Sequence[Sequence[IdUse]]) -> list[str]:
    """In words, every id that two drivers of one bus would both use. One driver may use its own ids as it likes."""
    return [
        f"{_use(one)} and {_use(other)} share CAN ids: give one of them another id, or a bus of its own"
        for first, second in combinations(drivers, 2)
        for one in first
        for other in second
        if one.extended == other.extended and not (one.id ^ other.id) & one.mask & other.mask
    ]


def _use(use: IdUse) -> str:
    last = use.id | ~use.mask & (EXTENDED_IDS if use.extended else STANDARD_IDS)
    return f"{use.user} (0x{use.id:X})" if last == use.id else f"{use.user} (0x{use.id:X} to 0x{last:X})"
