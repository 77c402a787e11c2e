"""All commands in one table; each lives in the module named after what it is about.

Only the module of the command that is called is imported: the daemon must not carry what the others need (Rerun
alone would cost it 80 MB and half a second), and a stop should not wait for imports either. For the list of all of them
none is: what they say of themselves is read from their source.
"""

import ast
import gc
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from gateway.cli.output import complain, console
from gateway.cli.parts import missing
from gateway.errors import UserError

COMMANDS = {  # command: module of gateway.cli that has a function (or a group) of that name
    "run": "run",
    "check": "check",
    "explain": "explain",
    "format": "format",
    "doctor": "doctor",
    "report": "report",
    "drive": "drive",
    "send": "operate",
    "path": "path",
    "watch": "operate",
    "events": "operate",
    "stop": "operate",
    "reference": "reference",
    "stand": "stand",
    "set": "setting",
    "mark": "mark",
    "fault": "fault",
    "calibrate": "calibrate",
    "setup": "setup",
    "demo": "demo",
    "sim": "sim",
    "scenario": "scenario",
    "replay": "replay",
    "reproduce": "reproduce",
}
SIGNED = {"set"}  # commands with an argument that is a number, so that -1 is none of their options


def _show_version(asked: bool) -> None:
    if asked:
        from gateway.build import version  # noqa: PLC0415  # reads what is installed, which takes its time

        console.print(f"drivegate {version()}", highlight=False)
        raise typer.Exit


def build(called: str | None) -> typer.Typer:
    """The command line with the command that is called; where that is none, or unknown, with a list of all of them."""
    app = typer.Typer(
        name="drivegate",
        help="From a velocity command over Zenoh to CAN motor controllers, recorded and replayable.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",  # joins the lines of a docstring
    )
    app.callback()(_options)  # also keeps the command's name in use even when it is the only one
    if called not in COMMANDS:
        for name in COMMANDS:
            app.command(name, help=said_of(name))(_listed)
        return app
    command = getattr(import_module(f"gateway.cli.{COMMANDS[called]}"), called)
    if isinstance(command, typer.Typer):
        app.add_typer(command, name=called)
    else:
        app.command(called, context_settings={"ignore_unknown_options": called in SIGNED})(command)
    return app


def said_of(name: str) -> str:
    """The docstring of a command, or the `help` of a group, without importing what it needs."""
    source = Path(__file__).with_name(f"{COMMANDS[name]}.py").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        match node:
            case ast.FunctionDef(name=found) if found == name:
                return ast.get_docstring(node) or ""
            case ast.Assign(targets=[ast.Name(id=found)], value=ast.Call(keywords=given)) if found == name:
                return next(
                    (
                        str(one.value.value)
                        for one in given
                        if isinstance(one.value, ast.Constant) and one.arg == "help"
                    ),
                    "",
                )
    raise LookupError(name)


def _listed() -> None:
    """Stands for a command where all of them are listed."""


def _options(
    version: Annotated[
        bool,
        typer.Option("--version", help="Version and form of the core.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Options of the command line itself."""


def main() -> None:
    """Entry point of the console script: errors of the user's making are words, not tracebacks."""
    try:
        gc.disable()  # what is imported stays: to look for garbage in it takes a quarter of a short command
        command = build(next((word for word in sys.argv[1:] if not word.startswith("-")), None))
        gc.freeze()
        gc.enable()
        command()
    except UserError as error:
        _leave(error)
    except ModuleNotFoundError as error:
        part = missing(error)
        if part is None:
            raise
        _leave(part)


def _leave(error: UserError) -> NoReturn:
    complain(str(error))
    sys.exit(error.exit_code)
