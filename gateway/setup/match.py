"""The controllers that answer against those of a robot file. Pure."""

from collections.abc import Sequence
from typing import NamedTuple

from gateway.config import Motor, RobotConfig
from gateway.setup.census import Found


class Match(NamedTuple):
    """`there`: names of motors whose controller answers; the rest is what does not fit."""

    there: tuple[str, ...]
    missing: tuple[str, ...]
    strangers: tuple[str, ...]  # controllers that no motor of the file has

    def lines(self) -> list[str]:
        """In words, one each."""
        there = f"in the robot file and here: {', '.join(self.there) or 'none'}"
        missing = [f"motor {name} does not answer" for name in self.missing]
        return [there, *missing, *(f"{name} answers, but no motor of the robot file has it" for name in self.strangers)]


def is_of(motor: Motor, found: Found) -> bool:
    """Whether this controller can be that of the motor."""
    return (motor.driver, motor.id) == (found.driver, found.id) and motor.variant in found.variants


def match(config: RobotConfig, found: Sequence[Found]) -> Match:
    """Of the motors of this file."""
    there = [motor.name for motor in config.motor if any(is_of(motor, one) for one in found)]
    return Match(
        there=tuple(there),
        missing=tuple(motor.name for motor in config.motor if motor.name not in there),
        strangers=tuple(one.name for one in found if not any(is_of(motor, one) for motor in config.motor)),
    )
