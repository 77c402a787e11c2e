"""Every code that can be told has its words: found where it is told, not in a list typed twice."""

import ast
import json
import re
from collections.abc import Callable, Iterator
from enum import Enum
from importlib import import_module
from pathlib import Path

import pytest
from typer.testing import CliRunner

import drivers.odrive.firmware as odrive
import drivers.twins
from drivers import DRIVERS
from drivers.sensors import counted
from drivers.sensors.contract import Heard
from gateway import words
from gateway.cli.app import build
from gateway.control import odd_width
from gateway.core.health import FaultKind
from gateway.types import BusEventKind, Mode, RefusalCode, RequestKind

ROOT = Path(__file__).parent.parent.parent
ANSWERED = set(RequestKind) - {RequestKind.ESTOP, RequestKind.SHUTDOWN}  # a stop and an end are told by the mode
KINDS: dict[str, type[Enum]] = {
    "fault_": FaultKind,
    "cleared_": FaultKind,
    "bus_": BusEventKind,
    "refused_": RefusalCode,
    "mode_": Mode,
}
TOLD_BY = {"Event", "_counted"}  # what makes an event: its second argument is the code
TOLD_BY_LAWS = {*TOLD_BY, "_tell"}


def calls(path: Path) -> Iterator[ast.Call]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            yield node


def name_of(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")


def codes_of(path: Path, told: ast.expr) -> set[str] | None:
    """What this expression can be; None: that is decided elsewhere."""
    if isinstance(told, ast.Constant):
        return {str(told.value)}
    if isinstance(told, ast.Name) and told.id.isupper():
        module = import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
        return {getattr(module, told.id)}
    text = ast.unparse(told)
    prefix = text[2:].partition("{")[0]
    if text.startswith("f'") and prefix in KINDS:
        return {prefix + str(one.value) for one in KINDS[prefix]}
    return OTHERS[text](path) if text in OTHERS else None


OTHERS: dict[str, Callable[[Path], set[str]]] = {
    "f'region_{stage.value}'": lambda path: {
        f"region_{stage.lower()}" for stage in re.findall(r"_held_back\(Stage\.(\w+)", path.read_text())
    },
    "f'{kind}_refused'": lambda _: {f"{kind.value}_refused" for kind in ANSWERED},
    "kind": lambda _: {str(kind.value) for kind in ANSWERED},
}

# Where the code is a variable: the lines before it say which.
VARIABLE = {
    "gateway/control/odd_width.py": {code for _, code in odd_width._EVENTS.values()},
    "gateway/control/region_policy.py": set(),  # `_tell` itself, whose callers are found
    "gateway/core/reporter.py": {"sensor_silent", "sensor_heard", "sensor_jump"},
    "gateway/recording/schema.py": set(),  # read back from a recording
}


def told_events() -> set[str]:
    found: set[str] = set()
    variable: set[str] = set()
    for path in sorted((ROOT / "gateway").rglob("*.py")):
        for call in calls(path):
            told_by = TOLD_BY_LAWS if path.parent.name == "control" else TOLD_BY
            if name_of(call) in told_by and len(call.args) > 1:
                codes = codes_of(path, call.args[1])
                if codes is None:
                    variable.add(path.relative_to(ROOT).as_posix())
                found |= codes or set()
    assert variable == set(VARIABLE), "an event whose code is a variable"
    for name, codes in VARIABLE.items():
        text = (ROOT / name).read_text()
        assert all(f'"{code}"' in text for code in codes)
        found |= codes
    return found


def driver_codes() -> set[str]:
    found = {drivers.twins.CODE, odrive.DEVICE_ERROR}
    for path in sorted((ROOT / "drivers").rglob("*.py")):
        for call in calls(path):
            if name_of(call) == "DriverFault" and isinstance(call.args[0], ast.Constant):
                found.add(str(call.args[0].value))
    for line in odrive.FIRMWARES.values():
        for table in (line.errors, *(reason.words for reason in line.reasons.values())):
            found |= {bit.code for bit in table.values()}
    return found


def sensor_words() -> set[str]:
    flaws = {one.flaw for one in vars(counted).values() if isinstance(one, Heard)}
    return {*counted.STATES.values(), *(flaw for flaw in flaws if flaw is not None)}


def test_every_event_and_fault_is_explained_and_nothing_else() -> None:
    told = told_events()
    assert {"fault_stall", "bus_down", "launch_slipped", "pull_lost", "width_held", "balance_lost", "gap"} <= told
    explained = {*words.TABLES["fault"], *words.TABLES["event"]}
    explained |= {words.CLEARED + code.removeprefix(words.FAULT) for code in words.TABLES["fault"]}
    assert explained == told


def test_every_reason_of_a_driver_is_explained_and_nothing_else() -> None:
    assert set(words.TABLES["driver"]) == driver_codes()


def test_every_word_of_a_vendor_is_explained_and_nothing_else() -> None:
    assert set(words.VENDORS) == set(DRIVERS)
    for name, driver in DRIVERS.items():
        assert set(words.VENDORS[name]) == set(driver.words), name
    assert {"DRV_FAULT", "UNBALANCED_PHASES", "SPINOUT_DETECTED", "NOT_CONVERGING"} <= set(DRIVERS["odrive"].words)


def test_every_word_of_a_sensor_is_explained_and_nothing_else() -> None:
    assert set(words.TABLES["sensor"]) == sensor_words()


@pytest.mark.parametrize("one", words.every(), ids=lambda one: f"{one.table}-{one.code}")
def test_every_entry_is_whole(one: words.Explanation) -> None:
    meaning, causes, cures = one.words
    assert meaning[0].isupper()
    assert meaning.endswith((".", "anew")), "a sentence"
    assert all(line and not line.endswith(".") for line in (*causes, *cures))
    assert one.table in words.TITLES
    if one.table == "fault":
        assert causes
        assert cures, "whoever has a fault has to know what to do"


def test_commands_named_in_the_words_are_commands() -> None:
    from gateway.cli.app import COMMANDS  # noqa: PLC0415

    text = " ".join(" ".join((one.words.meaning, *one.words.causes, *one.words.cures)) for one in words.every())
    named = set(re.findall(r"`drivegate (\w+)", text))
    assert named <= set(COMMANDS)
    assert {"doctor", "reference", "stop"} <= named


def explained(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(build("doctor"), ["doctor", "--explain", *arguments])
    return done.exit_code, done.output


ASKED = [
    (
        "fault_stall",
        ["fault_stall (fault", "likely causes, the likeliest first:", "    1. the wheel is blocked", "what to do:"],
    ),
    ("stall", ["fault_stall (fault"]),
    ("cleared_stall", ["fault_stall (fault"]),
    ("mode_idle", ["mode_idle (event)"]),
    ("drv_fault", ["DRV_FAULT (word of an ODrive"]),
    ("OVERSPEED", ["overspeed (reason of a driver", "OVERSPEED (word of an ODrive", "OVERSPEED (word of a VESC"]),
    ("fault", ["fault_stall (fault", "fault_silent (fault", "fault_bus (fault"]),
    ("motor error flag", ["motor error flag (word of an ODrive"]),
]


@pytest.mark.parametrize(("code", "shown"), ASKED)
def test_what_is_printed(code: str, shown: list[str]) -> None:
    exit_code, output = explained(code)
    assert exit_code == 0
    assert all(line in output for line in shown), output


def test_all_of_them_and_one_that_is_none() -> None:
    _, output = explained("all", "--json")
    document = json.loads(output)
    assert len(document["codes"]) == len(words.every())
    assert set(document["codes"][0]) == {"table", "code", "meaning", "causes", "cures"}
    _, output = explained("all")
    assert all(one.code in output for one in words.every())
    exit_code, output = explained("fault_stal")
    assert exit_code == 1
    assert (
        "'fault_stal' is no code of ours and no vendor's word (`doctor --explain all`); did you mean 'fault_stall'?"
        in output
    )
