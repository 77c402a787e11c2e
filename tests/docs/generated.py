"""Parts of the documentation that are made from the code: `<!-- generated: NAME ARGUMENTS -->` on a line of a page."""

import ast
import inspect
import io
import tokenize
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from math import pi
from types import NoneType, UnionType
from typing import Final, NamedTuple, get_args, get_origin, get_type_hints

from pydantic import BaseModel
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption
from typer.main import get_command

from gateway import robot_files
from gateway import types as flowing
from gateway.chassis import CHASSIS
from gateway.cli.app import COMMANDS, build
from gateway.config import RobotConfig, load
from gateway.edges import messages
from gateway.file_keys import Rule, rules
from gateway.words import TABLES, TITLES
from tests.docs.pages import DOCS, ROOT

COMMAND: Final = "drivegate"
TERMINAL: Final = DOCS / "terminal"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _code(text: str) -> str:
    return f"`{text}`" if text else ""


# -- the robot file ---------------------------------------------------------------------------------------------------


def robot_file() -> str:
    """Every key, a table for each section; what of [robot] not every chassis has, in a table of each."""
    every = list(rules(RobotConfig))
    same = Counter(rule._replace(chassis=None) for rule in every if rule.chassis)
    sections: dict[str, list[Rule]] = {}
    for rule in every:
        plain = rule._replace(chassis=None)
        kind = rule.chassis if rule.chassis and same[plain] < len(CHASSIS) else None
        section = rule.key.split(".")[0]
        of = sections.setdefault(f"{section}, of {kind}" if kind else section, [])
        if kind or plain not in of:
            of.append(plain)
    return "\n\n".join(f"### {title}\n\n{_keys(found)}" for title, found in sections.items())


def _keys(found: Sequence[Rule]) -> str:
    head = ("key", "what it is", "allowed", "left out")
    return table(head, ((_code(rule.key), rule.meaning or "", rule.allowed, _left_out(rule)) for rule in found))


def _left_out(rule: Rule) -> str:
    return "**required**" if rule.default is None else _code(rule.default)


# -- the command line -------------------------------------------------------------------------------------------------


class Leaf(NamedTuple):
    """A command that does something: its words, and what Typer knows of it."""

    words: tuple[str, ...]
    command: TyperCommand


def leaves() -> Iterator[Leaf]:
    """Every command, those of groups one by one."""
    for called in COMMANDS:
        whole = get_command(build(called))
        assert isinstance(whole, TyperGroup)
        yield from _leaves((called,), whole.commands[called])


def _leaves(words: tuple[str, ...], command: object) -> Iterator[Leaf]:
    if isinstance(command, TyperCommand):
        yield Leaf(words, command)
    elif isinstance(command, TyperGroup):
        for word, below in command.commands.items():
            yield from _leaves((*words, word), below)


def command_line() -> str:
    """Every command with its arguments and options."""
    return "\n\n".join(_command(leaf) for leaf in leaves())


def _command(leaf: Leaf) -> str:
    called, command = " ".join((COMMAND, *leaf.words)), leaf.command
    assert command.callback is not None
    kinds = get_type_hints(inspect.unwrap(command.callback))
    arguments = [f"{one.name}".upper() for one in command.params if isinstance(one, TyperArgument)]
    rows = [
        _parameter(one, kinds[str(one.name)]) for one in command.params if isinstance(one, TyperArgument | TyperOption)
    ]
    return "\n\n".join(
        [
            f"### {called}",
            inspect.cleandoc(command.help or ""),
            f"```text\n{' '.join((called, '[OPTIONS]', *arguments))}\n```",
            table(("", "what it is", "left out"), rows),
        ]
    )


def _parameter(one: TyperArgument | TyperOption, kind: object) -> tuple[str, str, str]:
    names = str(one.name).upper() if isinstance(one, TyperArgument) else ", ".join([*one.opts, *one.secondary_opts])
    choices = [str(one.value) for one in _choices(kind)]
    words = " ".join((one.help or "").split())
    allowed = f" One of {', '.join(map(_code, choices))}." if choices else ""
    told = (
        "" if one.default is None or isinstance(one.default, bool) else str(getattr(one.default, "value", one.default))
    )
    return _code(names), f"{words}{allowed}", "**required**" if one.required else _code(told)


def _choices(kind: object) -> Iterator[Enum]:
    for one in (kind, *get_args(kind)):
        if isinstance(one, type) and issubclass(one, Enum):
            yield from one


# -- codes ------------------------------------------------------------------------------------------------------------


def codes() -> str:
    """What every code means, why, and what to do: as `drivegate doctor --explain all`."""
    parts = []
    for name, entries in TABLES.items():
        if not entries:
            continue
        parts.append(f"## {TITLES[name][0].upper()}{TITLES[name][1:]}")
        for code, words in entries.items():
            parts.append(f"### {code}\n\n{words.meaning}")
            if words.causes:
                parts.append("Likely causes:\n\n" + "\n".join(f"- {cause}" for cause in words.causes))
            if words.cures:
                parts.append("What to do:\n\n" + "\n".join(f"{n}. {cure}" for n, cure in enumerate(words.cures, 1)))
    return "\n\n".join(parts)


# -- Zenoh ------------------------------------------------------------------------------------------------------------

_SENT: Final[Mapping[str, type[BaseModel]]] = {
    "A twist": messages._TwistPayload,
    "A heading": messages._HeadingPayload,
    "An attitude": messages._AttitudePayload,
    "A range": messages._RangePayload,
    "A reference": messages._ReferencePayload,
    "A setting": messages._SettingPayload,
    "A mark": messages._MarkPayload,
}
_TOLD: Final[Mapping[str, type]] = {
    "odometry": messages.OdometryMessage,
    "event": messages.EventMessage,
    "truth": messages.TruthMessage,
    "answer to what is asked": messages.ResetAnswer,
    "state": flowing.Status,
    "motors of state": flowing.MotorStatus,
    "sources of state": flowing.SourceStatus,
    "sensors of state": flowing.SensorStatus,
    "settings of state": flowing.SettingStatus,
    "slip of state": flowing.SlipStatus,
    "reachable": flowing.AbilityStatus,
}


def zenoh_keys() -> str:
    """The table of keys in `gateway.edges.messages`."""
    lines = (messages.__doc__ or "").splitlines()
    return "\n".join(line for line in lines if line.startswith("|"))


def zenoh_sent() -> str:
    """What may be in each payload that a robot takes: from the models that judge it."""
    return "\n\n".join(f"### {title}\n\n{_payload(model)}" for title, model in _SENT.items())


def _payload(model: type[BaseModel]) -> str:
    rows = []
    for key, field in model.model_fields.items():
        left_out = "**required**" if field.is_required() else _code(str(field.default).replace("None", "null"))
        rows.append((_code(key), messages._ALLOWED[key], left_out))
    return table(("key", "value", "left out"), rows)


def zenoh_told() -> str:
    """The fields of each payload that a robot sends."""
    return "\n\n".join(f"### `{title}`\n\n{_fields(kind)}" for title, kind in _TOLD.items())


def _fields(kind: type) -> str:
    said = _comments(kind)
    rows = [(_code(key), _form(hint), said.get(key, "")) for key, hint in get_type_hints(kind).items()]
    return f"{inspect.cleandoc(kind.__doc__ or '')}\n\n{table(('field', 'form', 'what it is'), rows)}"


_FORMS: Final = {float: "number", int: "whole number", str: "text", bool: "true or false", NoneType: "null"}


def _form(hint: object) -> str:
    """A type as it is in JSON: a tuple is a list, a named one an object."""
    inside = get_args(hint)
    if isinstance(hint, UnionType):
        return " or ".join(map(_form, inside))
    if get_origin(hint) is tuple:
        words = _form(inside[0])
        return f"list of ({words})" if " or " in words else f"list of {words}"
    if isinstance(hint, type) and issubclass(hint, Enum):
        return "one of " + ", ".join(_code(str(one.value)) for one in hint)
    names = getattr(hint, "_fields", None)
    if names is not None:
        return "{" + ", ".join(map(_code, names)) + "}"
    return _FORMS.get(hint, "object") if isinstance(hint, type) else "object"


def _comments(kind: type) -> dict[str, str]:
    """The comment behind each field."""
    found: dict[str, str] = {}
    name = ""
    for token in tokenize.generate_tokens(io.StringIO(inspect.getsource(kind)).readline):
        if token.type == tokenize.NAME and token.line.split(":")[0].strip() == token.string:
            name = token.string
        elif token.type == tokenize.COMMENT and name and token.line.strip().startswith(name):
            found[name] = token.string.lstrip("# ").replace("None", "null")
    return found


# -- chassis ----------------------------------------------------------------------------------------------------------


def wheel_matrix(robot: str, degrees: str = "0") -> str:
    """What each motor turns for one unit of each axis: from the kinematics; joints stand at so many degrees."""
    config, _ = load(robot_files.find_bundled(robot))
    moves = config.robot.kinematics()
    angles = [float(degrees) / 180.0 * pi] * len(config.robot.motor_names())
    per = {axis: f"per {'rad/s' if axis == 'wz' else 'm/s'} of {axis}" for axis in moves.axes}
    rows = [
        (name, *(f"{part + 0.0:.4f}" for part in row))
        for name, row in zip(config.robot.motor_names(), moves.matrix(angles), strict=True)
    ]
    return table(("rad/s of", *per.values()), rows)


def wheel_speeds(robot: str, *rates: str) -> str:
    """What the wheels turn for one motion, and what those speeds say of the motion."""
    config, _ = load(robot_files.find_bundled(robot))
    moves = config.robot.kinematics()
    wanted = tuple(map(float, rates))
    joints = [0.0] * len(config.robot.motor_names())
    speeds = moves.wheel_speeds(wanted, joints)
    assert speeds is not None
    found = moves.twist(speeds, joints)
    assert found is not None
    names = config.robot.motor_names()
    motion = ", ".join(f"{axis} = {rate:g}" for axis, rate in zip(moves.axes, wanted, strict=True))
    back = ", ".join(f"{round(rate, 9) + 0.0:g}" for rate in (*found.twist, *found.more))
    rows = [(name, f"{speed + 0.0:.3f}") for name, speed in zip(names, speeds, strict=True)]
    return f"For {motion}:\n\n{table(('motor', 'rad/s'), rows)}\n\nand back from these speeds: {back}."


def bundled_robots() -> str:
    """The robot files that come with the package."""
    rows = []
    for name, path in robot_files.bundled().items():
        config, _ = load(path)
        drivers = sorted({f"{motor.driver} {motor.variant}" for motor in config.motor})
        rows.append((_code(name), config.robot.kind, ", ".join(drivers), str(len(config.motor))))
    return table(("name", "chassis", "controllers", "motors"), rows)


def terminal(robot: str) -> str:
    """A session of a person at a terminal, as it was kept."""
    kept = (TERMINAL / f"{robot}.txt").read_text(encoding="utf-8")
    return f'<div class="terminal" markdown="1">\n\n```text\n{kept.rstrip()}\n```\n\n</div>'


def source(file: str, *names: str) -> str:
    """What a file of the project defines under these names, as it stands there."""
    text = (ROOT / file).read_text(encoding="utf-8")
    lines = text.splitlines()
    found = {name: node for node in ast.parse(text).body for name in _defined(node)}
    shown = []
    for name in names:
        node = found[name]
        begin = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", ()))])
        shown.append("\n".join(lines[begin - 1 : node.end_lineno]))
    gaps = ["\n" if shorter.count("\n") == 0 else "\n\n\n" for shorter in shown[:-1]]
    whole = "".join(part + gap for part, gap in zip(shown, [*gaps, ""], strict=True))
    return f"```python\n{whole}\n```"


def _defined(node: ast.stmt) -> list[str]:
    match node:
        case ast.ClassDef(name=name) | ast.FunctionDef(name=name):
            return [name]
        case ast.Assign(targets=[ast.Name(id=name)]):
            return [name]
        case ast.Assign(targets=[ast.Tuple(elts=several)]):
            return [one.id for one in several if isinstance(one, ast.Name)]
    return []


PARTS: Final[dict[str, Callable[..., str]]] = {
    "robot_file": robot_file,
    "command_line": command_line,
    "codes": codes,
    "zenoh_keys": zenoh_keys,
    "zenoh_sent": zenoh_sent,
    "zenoh_told": zenoh_told,
    "wheel_matrix": wheel_matrix,
    "wheel_speeds": wheel_speeds,
    "bundled_robots": bundled_robots,
    "terminal": terminal,
    "source": source,
}
