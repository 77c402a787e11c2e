"""Checks that every driver makes of the motors it is given, and the one rule for when feedback is too old."""

from collections.abc import Sequence

from drivers.interface import MotorSpec

MIN_FEEDBACK_TIMEOUT_NS = 50_000_000
FEEDBACK_TIMEOUT_PERIODS = 5


def check_specs(motors: Sequence[MotorSpec], *, driver: str, variants: Sequence[str], ids: range) -> None:
    """Raise ValueError for no motor, an unknown variant, an id out of range or one given twice."""
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


def feedback_timeout_ns(rate_hz: float) -> int:
    """Age at which a measurement that should come at this rate counts as missing."""
    return max(MIN_FEEDBACK_TIMEOUT_NS, int(FEEDBACK_TIMEOUT_PERIODS * 1e9 / rate_hz))
