"""What may be set while the robot runs: one row for each setting. A restart goes back to the robot file's value.

A setting is asked for by a request, which is recorded and replayed as every input is. None may move a robot by itself:
whoever reads one applies it through the limits, and only to what a command asks for.
"""

from collections.abc import Mapping
from math import isfinite
from typing import Final, NamedTuple

from gateway.types import SettingStatus


class Setting(NamedTuple):
    """`low` to `high`, in `unit`; `default` where the robot file's [settings] do not name it."""

    name: str
    unit: str
    low: float
    high: float
    default: float

    def refusal(self, value: float) -> str | None:
        """Why this value is none; None: it is one."""
        if isfinite(value) and self.low <= value <= self.high:
            return None
        return f"{self.name} = {value:g}: must be {self.low:g} to {self.high:g} {self.unit}"


SPEED_OVERRIDE: Final = Setting("speed_override", "of limits.velocity", 0.05, 1.0, 1.0)  # that commands may use
SETTINGS: Final = {setting.name: setting for setting in (SPEED_OVERRIDE,)}
KNOWN: Final = f"must be one of {', '.join(SETTINGS)}"


def problems(given: Mapping[str, float]) -> list[str]:
    """What is wrong with values that a file gives to settings."""
    found = [
        SETTINGS[name].refusal(value) if name in SETTINGS else f"{name!r}: {KNOWN}" for name, value in given.items()
    ]
    return [problem for problem in found if problem is not None]


class Settings:
    """The values now. One writer, the engine."""

    def __init__(self, given: Mapping[str, float]) -> None:
        self._values = {setting.name: given.get(setting.name, setting.default) for setting in SETTINGS.values()}

    def value(self, setting: Setting) -> float:
        """What it is now."""
        return self._values[setting.name]

    def set(self, name: str | None, value: float | None) -> str | None:
        """Takes a new value; why not, if not."""
        setting = SETTINGS.get(name or "")
        if setting is None or value is None:
            return f"setting = {name!r}: {KNOWN}"
        refusal = setting.refusal(value)
        if refusal is None:
            self._values[setting.name] = value
        return refusal

    def describe(self) -> tuple[SettingStatus, ...]:
        """All of them."""
        return tuple(
            [SettingStatus(one.name, self.value(one), one.unit, one.low, one.high) for one in SETTINGS.values()]
        )
