"""What is to happen in a simulated world, as people write it: `[[at]]` in a file, or words on the command line.

One vocabulary for drives that are given once more and for a simulated robot that runs: the entries are those of a
scenario (`replay.drive.scenario_file`), the faults those of `replay.drive.faults`.
"""

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from gateway.config import ConfigError, parse_as, read
from replay.drive.faults import RULES, FaultKind, Target
from replay.drive.scenario_file import At

# KIND@T, and how long, whom and how much: power_off@5:front_left, frames_lost@3+0.5=0.3, silence@2:teleop, estop@4
_WORDS = re.compile(
    r"(?P<kind>\w+)(@(?P<t>[\d.]+))?(\+(?P<seconds>[\d.]+))?(:(?P<name>[\w-]+))?(=(?P<value>-?[\d.e+-]+))?"
)
FORM = "KIND@SECONDS[+LASTING][:NAME][=VALUE]"
NOW_FORM = "KIND[@SECONDS][+LASTING][:NAME][=VALUE]"
ON_THE_COMMAND_LINE = "--fault"


class Script(BaseModel):
    """The whole file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 0
    at: list[At] = []


def read_script(path: Path) -> Script:
    """Raises ConfigError."""
    return parse_as(Script, read(path), str(path))


def in_words(words: str, *, now: bool = False) -> dict[str, Any]:
    """One thing that happens, from the command line, as an entry of a script. Raises ConfigError.

    `now`: without a time it happens at once.
    """
    found = _WORDS.fullmatch(words)
    if found is None or (found["t"] is None and not now):
        form, example = (NOW_FORM, "power_off:front_left") if now else (FORM, "power_off@5:front_left")
        raise ConfigError(ON_THE_COMMAND_LINE, [f"{words!r}: must be {form}, as in {example}"])
    kind, name = found["kind"], found["name"]
    t, seconds, value = (
        None if found[key] is None else _number(words, found[key]) for key in ("t", "seconds", "value")
    )
    t = 0.0 if t is None else t
    if kind == "silence":
        return {"t": t, "silence": name or ""}
    if kind not in {one.value for one in FaultKind}:
        return {"t": t, "request": kind}
    target = _target(FaultKind(kind))
    given = {"kind": kind, "seconds": seconds, "value": value, target: name}
    return {"t": t, "fault": {key: one for key, one in given.items() if one is not None}}


def script_of(entries: list[dict[str, Any]], seed: int = 0) -> Script:
    """Checked like a file. Raises ConfigError."""
    return parse_as(Script, text_of(entries, seed), ON_THE_COMMAND_LINE)


def text_of(entries: list[dict[str, Any]], seed: int = 0) -> str:
    """As a file would have it."""
    return "\n".join([f"seed = {seed}", f"at = {_inline(entries)}"])


def _target(kind: FaultKind) -> str:
    return {Target.BUS: "bus", Target.SENSOR: "sensor"}.get(RULES[kind].target, "motor")


def _number(words: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(ON_THE_COMMAND_LINE, [f"{words!r}: {text!r} is no number"]) from None


def _inline(value: object) -> str:
    """As TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_inline(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float | int) else f'"{value}"'
