"""The rooms and the directions of import between them, read from the syntax tree."""

import ast
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("drivers", "gateway", "replay")
GROUND = (
    "gateway/arithmetic.py",
    "gateway/build.py",
    "gateway/errors.py",
    "gateway/guess.py",
    "gateway/types.py",
    "gateway/sections.py",
    "gateway/__init__.py",
)
ROBOT_FILE = ("gateway/config.py", "gateway/file_keys.py", "gateway/robot_files.py")

# Each room and what it may import besides the standard library and its own folder. "ground" is types and what robot
# files are made of; "robot file" is config and robot_files; "entrance" is service and client; a folder without an entry
# here is no room and fails.
ROOMS: dict[str, set[str]] = {
    "drivers": {"drivers/odrive"},
    "drivers/odrive": {"drivers"},
    "drivers/sensors": {"drivers"},
    "ground": {"drivers"},
    "gateway/kinematics": {"drivers", "ground"},
    "gateway/words": set(),
    "gateway/chassis": {"ground", "gateway/kinematics", "gateway/control"},
    "robot file": {"ground", "gateway/chassis"},
    "gateway/control": {"drivers", "ground", "gateway/kinematics"},
    "gateway/paths": {"ground", "robot file", "gateway/control"},
    "gateway/core": {
        *("drivers", "drivers/sensors", "ground", "gateway/kinematics", "gateway/chassis", "robot file"),
        "gateway/control",
    },
    "gateway/teleop": {"ground"},
    "gateway/setup": {
        *("drivers", "drivers/odrive", "ground", "gateway/chassis", "robot file", "gateway/control", "gateway/core"),
    },
    "gateway/edges": {"drivers", "ground", "robot file", "gateway/core", "gateway/teleop"},
    "gateway/recording": {"drivers", "ground", "gateway/chassis", "robot file", "gateway/core", "gateway/edges"},
    "entrance": {
        "drivers",
        "ground",
        "robot file",
        "gateway/control",
        "gateway/core",
        "gateway/edges",
        "gateway/paths",
        "gateway/setup",
    },
    "replay": set(),
    "replay/sim/controllers": {"drivers", "ground"},
    "replay/sim/plants": {"ground", "gateway/chassis", "replay/sim/controllers"},
    "replay/sim/sensors": {"drivers", "ground", "replay/sim/controllers"},
    "replay/sim": {
        *("drivers", "ground", "robot file", "gateway/edges", "replay/sim/controllers", "replay/sim/plants"),
        "replay/sim/sensors",
    },
    "replay/sessions": {"drivers", "ground", "gateway/recording"},
    "replay/sharing": {"ground", "robot file", "gateway/core", "gateway/recording", "replay/sessions"},
    "replay/compare": {"drivers", "ground", "robot file", "gateway/core", "replay/sessions"},
    "replay/report": {
        *("ground", "gateway/chassis", "robot file", "gateway/core", "replay/sessions", "replay/compare"),
    },
    "replay/logs": {
        *("drivers", "ground", "robot file", "gateway/core"),
        *("replay/sessions", "replay/compare", "replay/drive"),
    },
    "replay/drive": {
        *("drivers", "ground", "robot file", "entrance", "gateway/core", "gateway/edges", "gateway/recording"),
        *("replay/sessions", "replay/compare", "replay/sim", "replay/sim/plants", "replay/sim/sensors"),
    },
    "replay/history": set(),
    "replay/inject": {
        *("ground", "robot file", "gateway/control", "replay/sessions", "replay/drive", "replay/sim/plants"),
    },
    "replay/identify": {
        *("drivers", "ground", "robot file", "gateway/chassis", "gateway/control", "gateway/core"),
        *("replay/sessions", "replay/compare", "replay/drive", "replay/sim/plants"),
    },
    "replay/calibrate": {
        *("ground", "robot file", "gateway/chassis", "gateway/kinematics", "gateway/setup"),
        *("replay/sessions", "replay/identify"),
    },
    "replay/reproduce": {
        *(
            "ground",
            "robot file",
            "gateway/chassis",
            "gateway/control",
            "gateway/kinematics",
            "gateway/core",
            "gateway/paths",
        ),
        *("replay/drive", "replay/sim/controllers", "replay/sim/plants"),
    },
}
COMPOSITION_ROOT = "gateway/cli"  # imports whatever it puts together; nobody but the entrance imports it

PURE = (
    *("drivers", "drivers/odrive", "drivers/sensors", "ground", "robot file"),
    *("gateway/kinematics", "gateway/chassis", "gateway/control", "gateway/core", "gateway/paths", "gateway/words"),
    *("gateway/setup", "gateway/teleop"),
)
IMPURE = {"can", "multiprocessing", "os", "rerun", "signal", "socket", "subprocess", "threading", "time", "zenoh"}
# Simulation and sessions are pure too, but for what opens files, sockets or processes.
IMPURE_FILES = {
    *("replay/compare/fleet.py", "replay/compare/side_by_side.py", "replay/compare/verify.py"),
    *("replay/drive/player.py", "replay/drive/redrive.py"),
    "replay/history/revisions.py",
    *("replay/logs/mf4.py", "replay/logs/mf4_files.py"),
    *("replay/sim/network_device.py", "replay/sim/server.py"),
}
IMPURE_ROOMS = ("gateway/edges", "gateway/recording", "entrance", COMPOSITION_ROOT)
RERUN_ROOMS = ("gateway/recording", "replay/sessions", COMPOSITION_ROOT)
PYDANTIC_FILES = {
    *(
        "gateway/sections.py",
        "gateway/config.py",
        "gateway/file_keys.py",
        "gateway/edges/messages.py",
        "replay/drive/scenario_file.py",
    ),
    "replay/drive/script.py",
    *("gateway/paths/path_file.py", "gateway/setup/courses.py", "gateway/setup/fields.py"),
}
TABLES_FILE = "replay/logs/export.py"  # besides the rooms of Rerun's the only one that knows Arrow
DRAWING_FILES = {"replay/reproduce/drawing.py", "gateway/cli/picture_png.py"}  # the only ones that know Matplotlib
PAGE_FILE = "replay/report/page.py"  # the only one that knows Jinja
CAN_FILE = "gateway/edges/python_can.py"  # whence everybody else has python-can
MF4_FILE = "replay/logs/mf4_files.py"  # the only one that knows asammdf, which is an extra
MF4_USERS = {"replay/logs/export.py"}  # within a function: it cannot be imported without that extra
# The only ones that know SciPy, which takes a third of a second to import.
FITTING_FILES = {
    *("replay/calibrate/fitting.py", "replay/calibrate/likelihood.py"),
    *("replay/identify/fit.py", "replay/identify/gains.py", "replay/identify/response.py"),
}
PYDANTIC_ROOMS = ("gateway/chassis",)  # each has its section of the robot file


def sources() -> list[Path]:
    return [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def room(path: Path) -> str:
    if name(path) in GROUND:
        return "ground"
    if name(path) in ROBOT_FILE:
        return "robot file"
    folder = path.parent.relative_to(ROOT).as_posix()
    return "entrance" if folder == "gateway" else folder


def module_path(module: str) -> Path | None:
    """Where a module of ours lies; None for other modules and for names within one."""
    stem = ROOT.joinpath(*module.split("."))
    found = stem.with_suffix(".py") if stem.with_suffix(".py").is_file() else stem / "__init__.py"
    return found if found.is_file() and module.split(".", maxsplit=1)[0] in PACKAGES else None


def rooms_of_imports(path: Path) -> set[str]:
    found = {module_path(module) for module in imports(path)}
    empty = {ROOT / "gateway" / "__init__.py"}  # `from gateway import x` says nothing of x
    return {room(one) for one in found if one is not None and one not in empty}


@pytest.mark.parametrize("path", sources(), ids=name)
def test_directions(path: Path) -> None:
    here = room(path)
    assert "tests" not in {module.split(".")[0] for module in imports(path)}
    if here == COMPOSITION_ROOT or name(path) == "gateway/__main__.py":
        return
    foreign = rooms_of_imports(path) - ROOMS[here] - {here}
    assert not foreign, f"{name(path)} is in {here}, which may import {sorted(ROOMS[here])}, not {sorted(foreign)}"


def test_the_rooms_that_are_and_the_arrows_that_are() -> None:
    """The table tells neither a room nor an arrow that does not exist, and there is no circle but the drivers' own."""
    arrows: dict[str, set[str]] = {room(path): set() for path in sources()}
    for path in sources():
        arrows[room(path)] |= rooms_of_imports(path) - {room(path)}
    del arrows[COMPOSITION_ROOT]
    arrows["entrance"] -= {COMPOSITION_ROOT}  # __main__
    assert arrows == ROOMS
    TopologicalSorter({here: there - {"drivers/odrive"} for here, there in ROOMS.items()}).prepare()


@pytest.mark.parametrize("path", [path for path in sources() if room(path).startswith("drivers")], ids=name)
def test_drivers_use_the_standard_library_only(path: Path) -> None:
    foreign = {module.split(".")[0] for module in imports(path)} - set(sys.stdlib_module_names) - {"drivers"}
    assert not foreign


@pytest.mark.parametrize("path", sources(), ids=name)
def test_core_is_pure(path: Path) -> None:
    modules = set(imports(path))
    tops = {module.split(".")[0] for module in modules}
    assert "can" not in tops or name(path) == CAN_FILE
    tops |= {"can"} if "gateway.edges.python_can" in modules else set()
    if room(path) not in IMPURE_ROOMS and name(path) not in IMPURE_FILES and room(path) not in RERUN_ROOMS:
        assert not tops & IMPURE, f"{name(path)} is no edge but imports {tops & IMPURE}"
    if room(path) not in RERUN_ROOMS:
        assert "rerun" not in tops
        assert "pyarrow" not in tops or name(path) == TABLES_FILE
    if name(path) not in DRAWING_FILES:
        assert "matplotlib" not in tops
    assert "jinja2" not in tops or name(path) == PAGE_FILE
    if name(path) != MF4_FILE:
        assert "asammdf" not in tops
    if name(path) not in FITTING_FILES:
        assert "scipy" not in tops
    if "pydantic" in tops:
        assert name(path) in PYDANTIC_FILES or room(path) in PYDANTIC_ROOMS


def test_what_an_extra_is_for_is_imported_where_it_is_used() -> None:
    importing = {name(path) for path in sources() if "replay.logs.mf4_files" in imports(path)}
    assert importing == MF4_USERS
    for user in MF4_USERS:
        tree = ast.parse((ROOT / user).read_text(encoding="utf-8"))
        assert not any(
            "mf4_files" in ast.unparse(node) for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)
        )


@pytest.mark.parametrize("path", [path for path in sources() if room(path) in PURE], ids=name)
def test_no_hidden_switches(path: Path) -> None:
    """No flag of the core may ask whether it is replayed or simulated."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.If):
            words = {part.id for part in ast.walk(node.test) if isinstance(part, ast.Name)}
            assert not words & {"replay", "replaying", "simulated", "simulate", "sim"}, f"{name(path)}:{node.lineno}"


# What Python itself computes exactly or rounds correctly; everything else in `math` is the C library's, which differs
# between processors and versions.
EXACT_MATH = {
    *("ceil", "copysign", "fabs", "floor", "fmod", "frexp", "fsum", "inf", "isclose", "isfinite", "isinf", "isnan"),
    *("nan", "nextafter", "pi", "remainder", "sqrt", "tau", "trunc", "ulp"),
}
INEXACT_MODULES = {"cmath", "numpy", "scipy", "statistics"}
INEXACT_BUILTINS = {"pow", "sum"}  # the C library's pow; compensated from Python 3.12 on, and not before


def inexact(path: Path) -> Iterator[str]:
    """What may give other bits on another processor, with its line."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Import(names=names):
                found = [alias.name for alias in names if alias.name.split(".")[0] in {"math", *INEXACT_MODULES}]
            case ast.ImportFrom(module="math", names=names):
                found = [f"math.{alias.name}" for alias in names if alias.name not in EXACT_MATH]
            case ast.ImportFrom(module=str(module)):
                found = [module] if module.split(".")[0] in INEXACT_MODULES else []
            case ast.BinOp(op=ast.MatMult()) | ast.AugAssign(op=ast.MatMult()):
                found = ["@"]
            case ast.BinOp(left=ast.Constant(value=int()), op=ast.Pow(), right=ast.Constant(value=int())):
                found = []  # a whole number, computed by the compiler
            case ast.BinOp(op=ast.Pow()) | ast.AugAssign(op=ast.Pow()):
                found = ["**"]
            case ast.Call(func=ast.Name(id=called)):
                found = [called] if called in INEXACT_BUILTINS else []
            case _:
                found = []
        yield from (f"{one} in line {getattr(node, 'lineno', '?')}" for one in found)


@pytest.mark.parametrize("path", [path for path in sources() if room(path) in PURE], ids=name)
def test_the_core_computes_the_same_bits_on_every_processor(path: Path) -> None:
    """See gateway/arithmetic.py for what takes their place."""
    assert not list(inexact(path))


@pytest.mark.parametrize(
    "text",
    [
        *("from math import sin", "from math import hypot, sqrt", "import math", "import numpy as np"),
        *("from numpy.linalg import pinv", "a = b @ c", "a @= b", "a = b**2", "a **= b", "a = 2.0**-3", "a = 2**-b"),
        *("a = sum(b)", "a = pow(b, 2)", "import cmath", "from statistics import mean"),
    ],
)
def test_what_is_inexact_is_found(tmp_path: Path, text: str) -> None:
    path = tmp_path / "module.py"
    path.write_text(f"from math import pi, sqrt\nLIMIT = 10**13\n{text}\n", encoding="utf-8")
    assert len(list(inexact(path))) == 1


def test_every_package_has_sources() -> None:
    assert {name(path).split("/")[0] for path in sources()} == set(PACKAGES)


COMPILED_ROOMS = ("drivers", "gateway/core", "gateway/kinematics", "gateway/control")
COMPILED = [path for room in COMPILED_ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def test_no_compiled_module_has_a_final_tuple_of_numbers() -> None:
    """mypyc leaves one unset, where the first of its numbers is a float: annotate it by its type alone."""
    found = []
    for path in COMPILED:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        module = import_module(".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"))
        for node in tree.body:
            if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Tuple):
                kind = ast.unparse(node.annotation)
                value = getattr(module, ast.unparse(node.target))
                if kind.startswith("Final") and "..." not in kind and begins_with_a_float(value):
                    found.append(f"{path.name}:{node.lineno} {ast.unparse(node.target)}")
    assert found == []


def test_no_compiled_function_calls_two_kinds_of_error_alike() -> None:
    """mypyc gives a name one type, and the second kind would be a TypeError."""
    found = []
    for path in COMPILED:
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef):
                kinds: dict[str, set[str]] = {}
                for node in ast.walk(function):
                    if isinstance(node, ast.ExceptHandler) and node.name is not None and node.type is not None:
                        kinds.setdefault(node.name, set()).add(ast.unparse(node.type))
                found += [f"{path.name}: {function.name}: {name}" for name, of in kinds.items() if len(of) > 1]
    assert found == []


def begins_with_a_float(value: object) -> bool:
    """A tuple, maybe of tuples, and no named one."""
    while type(value) is tuple and value:
        value = value[0]
        if type(value) is float:
            return True
    return False
