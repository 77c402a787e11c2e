"""What may be set while the robot runs: one row for each setting. A restart goes back to the robot file's value.

A setting is asked for by a request, which is recorded and replayed as every input is. None may move a robot by itself:
whoever reads one applies it through the limits, and only to what a command asks for.
"""

from collections.abc import Mapping
from math import isfinite
from typing import Final, NamedTuple

from gateway.control.compensation import WHOLE_CIRCLE
from gateway.control.drive_law import DriveLaw
from gateway.control.launch import FRICTION, LEAST_FRICTION, MOST_FRICTION
from gateway.guess import guess
from gateway.types import SettingStatus


class Setting(NamedTuple):
    """`low` to `high`, in `unit`; `default` where the robot file's [settings] do not name it, None: never there."""

    name: str
    unit: str
    low: float
    high: float
    default: float | None

    def refusal(self, value: float) -> str | None:
        """Why this value is none; None: it is one."""
        if isfinite(value) and self.low <= value <= self.high:
            return None
        return f"{self.name} = {value:g}: must be {self.low:g} to {self.high:g} {self.unit}"


SPEED_OVERRIDE: Final = Setting("speed_override", "of limits.velocity", 0.05, 1.0, 1.0)  # that commands may use
# Only where the robot file has [robot.compensation], which also says what they are at the start.
COMPENSATION_GAIN: Final = Setting("compensation_gain", "(no unit)", 0.0, 4.0, None)
COMPENSATION_REGION: Final = Setting("compensation_region", "rad", 0.01, WHOLE_CIRCLE, None)
# Only where the robot file has [robot.grip], which also says what it is at the start.
GROUND_FRICTION: Final = Setting(FRICTION, "of the load", LEAST_FRICTION, MOST_FRICTION, None)
SETTINGS: Final = {
    setting.name: setting for setting in (SPEED_OVERRIDE, COMPENSATION_GAIN, COMPENSATION_REGION, GROUND_FRICTION)
}
KNOWN: Final = f"must be one of {', '.join(SETTINGS)}"


def problems(asked: Mapping[str, float]) -> list[str]:
    """What is wrong with values that somebody gives to settings, whatever the robot."""
    found = [
        SETTINGS[name].refusal(value) if name in SETTINGS else f"{name!r}: {KNOWN}{guess(name, SETTINGS)}"
        for name, value in asked.items()
    ]
    return [problem for problem in found if problem is not None]


def problems_of_file(given: Mapping[str, float]) -> list[str]:
    """The same of the robot file's [settings]."""
    elsewhere = [
        f"{name}: is said in the section of the robot that has it"
        for name in given
        if name in SETTINGS and SETTINGS[name].default is None
    ]
    return elsewhere or problems(given)


class Settings:
    """The values now. One writer, the engine. Those of the drive law are the law's, asked of it."""

    def __init__(self, given: Mapping[str, float], law: DriveLaw) -> None:
        self._law = law
        self._own = {
            setting.name: given.get(setting.name, setting.default)
            for setting in SETTINGS.values()
            if setting.default is not None
        }

    def value(self, setting: Setting) -> float:
        """What it is now."""
        own = self._own.get(setting.name)
        return self._law.settings[setting.name] if own is None else own

    def set(self, name: str | None, value: float | None) -> str | None:
        """Takes a new value; why not, if not."""
        setting = SETTINGS.get(name or "")
        if setting is None or value is None or setting.name not in self._names():
            return f"setting = {name!r}: must be one of {', '.join(self._names())}"
        refusal = setting.refusal(value)
        if refusal is not None:
            return refusal
        if setting.name not in self._own:
            return self._law.set(setting.name, value)
        self._own[setting.name] = value
        return None

    def describe(self) -> tuple[SettingStatus, ...]:
        """All that this robot has."""
        rows = [SETTINGS[name] for name in self._names()]
        return tuple([SettingStatus(one.name, self.value(one), one.unit, one.low, one.high) for one in rows])

    def _names(self) -> tuple[str, ...]:
        return (*self._own, *self._law.settings)
