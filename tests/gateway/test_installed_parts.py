"""Commands of an installation that has not every part: each works, or says in words what it lacks and how to get it."""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import pytest
import typer
from packaging.requirements import Requirement

from gateway.cli.app import COMMANDS
from gateway.cli.parts import PARTS, MissingPartError, cure, missing, need
from gateway.errors import EXIT_CONFIG, EXIT_UNAVAILABLE
from tests.world import ROBOTS

ROOT = ROBOTS.parents[1]
SESSION = ROOT / "tests" / "sessions" / "v2-moby"
ROBOT, DESK = tuple(PARTS["robot"]), tuple(PARTS["desk"])
HIDDEN = {"client": (*ROBOT, *DESK), "robot": DESK} | {f"robot without {one}": (one, *DESK) for one in ROBOT}
OK = 0

# Runs commands one after the other in one process that has not these packages; a line of JSON for each.
MANY = """
import contextlib, io, json, sys
for name in json.loads(sys.argv[1]):
    sys.modules[name] = None  # which the import system takes for "not there"
from gateway.cli import output
from gateway.cli.app import main
told = open(sys.argv[3], "w")
for words in json.loads(sys.argv[2]):
    said = io.StringIO()
    output.errors.file = said
    sys.argv = ["drivegate", *words]
    code = 0
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        except BaseException as error:
            code = repr(error)
    told.write(json.dumps([code, said.getvalue()]) + "\\n")
"""


def run_hidden(hidden: Sequence[str], commands: Sequence[Sequence[str]], where: Path) -> list[tuple[object, str]]:
    """Exit code and standard error of each."""
    told = where.with_name("told")
    done = subprocess.run(
        [sys.executable, "-c", MANY, json.dumps(hidden), json.dumps(commands), told],
        cwd=where,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    lines = [json.loads(line) for line in told.read_text(encoding="utf-8").splitlines()]
    assert len(lines) == len(commands), done.stderr
    return [(code, said) for code, said in lines]


def every_command() -> list[list[str]]:
    """All of them, those of groups included."""
    found = []
    for name, module in COMMANDS.items():
        command = getattr(import_module(f"gateway.cli.{module}"), name)
        if isinstance(command, typer.Typer):
            below = [one.name or str(one.callback.__name__) for one in command.registered_commands if one.callback]
            assert below
            found += [[name, one.replace("_", "-")] for one in below]
        else:
            found.append([name])
    return found


@pytest.fixture(scope="module")
def where(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded drive, logs and a robot file."""
    folder = tmp_path_factory.mktemp("parts")
    shutil.copytree(SESSION, folder / "session")
    (folder / "log.log").write_text("(1.000000) can0 123#01\n", encoding="utf-8")
    (folder / "log.mcap").write_bytes(b"\x89MCAP0\r\n")
    (folder / "robot.toml").write_text((ROBOTS / "moby.toml").read_text(encoding="utf-8"), encoding="utf-8")
    return folder


@pytest.mark.parametrize("hidden", HIDDEN.values(), ids=HIDDEN.keys())
def test_every_command_works_or_says_what_it_lacks(where: Path, hidden: Sequence[str]) -> None:
    commands = [[*words, "--help"] for words in every_command()]
    for words, (code, said) in zip(commands, run_hidden(hidden, commands, where), strict=True):
        assert code == OK or (code == EXIT_UNAVAILABLE and lacks(said, hidden)), (words, code, said)


def lacks(said: str, hidden: Sequence[str]) -> bool:
    """Whether it names a package that is hidden, and its cure."""
    return any(
        PARTS[part][module] in said and cure(part) in said
        for part in PARTS
        for module in PARTS[part]
        if module in hidden
    )


CLIENT = {  # what works without any part: with the exit codes that it has with all of them
    "check moby": OK,
    "check robot.toml --json": OK,
    "explain gear_ratio": OK,
    "format": OK,
    "format --json": OK,
    "path moby nowhere.toml --check": EXIT_CONFIG,
    "doctor --explain all": OK,
    "send moby --vx 0.1 --for 1 --connect tcp/127.0.0.1:9": EXIT_UNAVAILABLE,  # nobody listens there
    "watch moby --once --connect tcp/127.0.0.1:9": EXIT_UNAVAILABLE,
}


def test_a_client_commands_and_asks_without_any_part(where: Path) -> None:
    told = run_hidden(HIDDEN["client"], [words.split() for words in CLIENT], where)
    for words, (code, said) in zip(CLIENT, told, strict=True):
        assert code == CLIENT[words], (words, code, said)
        assert "not installed here" not in said, words


ROBOTS_OWN = {  # what needs the part of robots, and nothing more
    "replay verify session": OK,
    "replay info session": OK,
    "replay trace session": OK,
    "replay import log.log robot.toml --map can0=can0 --out imported": OK,
    "replay repair session --out repaired": OK,
}


def test_a_robot_replays_and_reads_logs_without_the_desk(where: Path) -> None:
    told = run_hidden(HIDDEN["robot"], [words.split() for words in ROBOTS_OWN], where)
    for words, (code, said) in zip(ROBOTS_OWN, told, strict=True):
        assert code == ROBOTS_OWN[words], (words, code, said)
        assert "not installed here" not in said, words


@pytest.mark.parametrize(
    ("words", "module"),
    [
        ("replay report session -o page.html", "jinja2"),
        ("replay identify session", "scipy"),
        ("replay import log.mcap robot.toml", "mcap"),
        ("replay export session other.mcap", "mcap"),
        ("reproduce moby-fig5 --out reproduced", "matplotlib"),
    ],
)
def test_what_the_desk_is_for_says_so_and_leaves_nothing(where: Path, words: str, module: str) -> None:
    before = sorted(where.iterdir())
    ((code, said),) = run_hidden(HIDDEN["robot"], [words.split()], where)
    assert (code, lacks(said, [module])) == (EXIT_UNAVAILABLE, True), (code, said)
    assert sorted(where.iterdir()) == before


def test_a_robot_that_cannot_record_does_not_start(where: Path) -> None:
    """Else it would drive for a day, and nothing of it would be there."""
    command = ["run", "robot.toml", "--simulate", "--out", "recorded", "--endpoint", "tcp/127.0.0.1:9"]
    ((code, said),) = run_hidden(["rerun"], [command], where)
    assert (code, lacks(said, ["rerun"])) == (EXIT_UNAVAILABLE, True), (code, said)
    assert not (where / "recorded").exists()


def test_the_parts_are_the_extras_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for part, packages in PARTS.items():
        wanted = {Requirement(one).name for one in project["optional-dependencies"][part]}
        assert wanted - {"drivegate"} == set(packages.values())
    everybody = {Requirement(one).name for one in project["dependencies"]}
    assert not everybody & {package for packages in PARTS.values() for package in packages.values()}


def test_a_module_of_no_part_is_a_bug_and_no_lack() -> None:
    assert missing(ModuleNotFoundError(name="gateway.nothing")) is None
    assert missing(ModuleNotFoundError()) is None
    with pytest.raises(MissingPartError, match="rerun-sdk"), pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "rerun", None)
        need("rerun")
    need("numpy")
