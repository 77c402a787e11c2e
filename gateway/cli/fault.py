"""`drivegate fault`: break a simulated robot that runs, and mend it."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from gateway.cli.operate import EXIT_REFUSED, Connect, open_client, tell
from gateway.cli.output import complain, console, print_json
from gateway.edges import keys
from replay.drive.faults import RULES, Rule
from replay.drive.live_faults import LIVE, entries_of
from replay.drive.script import NOW_FORM, read_script, script_of, text_of


def fault(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    name: Annotated[str | None, typer.Argument(help="Name of the simulated robot, or its robot file.")] = None,
    faults: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FAULT]...", help=f"{NOW_FORM}: power_off:front_left, frames_lost@3+0.5=0.3, clear."),
    ] = None,
    script: Annotated[Path | None, typer.Option(help="From a TOML file with [[at]] as in a scenario.")] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of what is left to chance.")] = 0,
    every: Annotated[bool, typer.Option("--list", help="Show what can break.")] = False,
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Break something on a running simulated robot, now or so many seconds from now; `clear` mends everything.

    Without NAME in a fault it concerns all motors, buses or sensors; with LASTING seconds it ends by itself. What is
    done is an event `mark`, in the recording too. A real robot has nothing that could be asked for it.
    """
    if every:
        _show(json=json)
        return
    text = _text(faults or [], script, seed)
    if name is None or text is None:
        raise typer.BadParameter("needs the NAME of a robot and a fault or --script; `--list` shows what can break")
    with open_client(name, connect) as client:
        answer = client.give_faults(text)
    if answer is None:
        complain(f"{name} is no simulated robot (it has no key {keys.FAULT}): only `drivegate run --simulate` breaks")
        raise typer.Exit(EXIT_REFUSED)
    tell(answer, json=json, done="given; `drivegate watch NAME` shows what the robot does about it")


def _text(words: list[str], script: Path | None, seed: int) -> str | None:
    """The script to be sent, checked as far as that goes without the robot. Raises ConfigError."""
    entries = entries_of(words)
    script_of(entries, seed)
    if script is None:
        return text_of(entries, seed) if entries else None
    read = read_script(script)
    return text_of([*(at.model_dump(mode="json", exclude_none=True) for at in read.at), *entries], seed or read.seed)


def _show(*, json: bool) -> None:
    if json:
        print_json({"faults": [{"kind": kind.value, **_row(RULES[kind])} for kind in LIVE]})
        return
    caption = "without a NAME: of all of them; `clear` without one mends buses, sensors and the world too"
    table = Table("fault", "of", "value", "ends by itself", caption=caption)
    for kind in LIVE:
        row = _row(RULES[kind])
        value = f"{row['value'] or ''}" + ("" if row["default"] is None else f"; {row['default']:g} if left out")
        table.add_row(kind.value, str(row["of"]), value, str(row["lasting"]))
    console.print(table)


def _row(rule: Rule) -> dict[str, object]:
    """What a kind concerns, its value in words, and whether it may (or must) end after so many seconds."""
    lasting = "must" if rule.timed else "may" if rule.end is not None else "never"
    value = None if rule.value is None else rule.value.words
    return {"of": rule.target.value, "value": value, "default": rule.default, "lasting": lasting}
