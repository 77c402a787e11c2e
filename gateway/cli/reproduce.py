"""`drivegate reproduce`: the experiments of the papers once more, each with a session, a picture and a table."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from gateway.cli.output import complain, console, errors, print_json
from gateway.config import ConfigError
from replay.reproduce.result import ReproduceError, Result

EXIT_MISSED = 1
PAGE = "reproduction.html"
WIDE = 140  # columns of a terminal that has room for what is allowed, and for the notes
Tell = Callable[[str], None]


def reproduce(
    name: Annotated[str | None, typer.Argument(help="Experiment; without one, all of them are listed.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Every experiment, and one page of them.")] = False,
    out: Annotated[Path, typer.Option(help="Directory for sessions, pictures and tables.")] = Path("reproduced"),
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Run experiments of the papers again, and compare.

    Each writes its sessions, a picture and a table (paper, ours, difference) into OUT/NAME; --all also writes one page
    of everything, OUT/reproduction.html. Exit 1 where a row misses what it is allowed, or a robot does not start.

    --json: name, rows (each quantity, paper, ours, unit, note), session, picture; also sessions, table and missed (the
    rows that do). With --all: experiments (a list of these), page and missed.
    """
    # Only now: numpy, Rerun and Matplotlib cost a second, and other commands have no use for them.
    experiments = import_module("replay.reproduce.experiments")
    known = experiments.EXPERIMENTS
    if name is None and not everything:
        _list(known, json=json)
        return
    if name is not None and everything:
        raise ConfigError("reproduce", [f"{name}: give either a name or --all"])
    if name is not None and name not in known:
        raise ConfigError("reproduce", [f"{name!r}: there is {', '.join(known)}"])
    names = list(known) if name is None else [name]
    started = time.clock_gettime_ns(time.CLOCK_REALTIME)
    results: list[Result] = []
    try:
        with _progress(sum(known[one].parts for one in names)) as tell:
            results += [experiments.reproduce(one, out, started_wall_ns=started, tell=tell(one)) for one in names]
        page = _write_page(results, out) if everything else None
    except OSError as error:
        raise ConfigError(str(out), [f"cannot be written: {error.strerror}"]) from None
    except ReproduceError as error:
        complain(str(error))
        raise typer.Exit(EXIT_MISSED) from None
    _tell(results, page, json=json)
    if any(result.missed for result in results):
        raise typer.Exit(EXIT_MISSED)


def _list(known: dict[str, object], *, json: bool) -> None:
    titles = {name: str(getattr(experiment, "title", "")) for name, experiment in known.items()}
    if json:
        print_json({"experiments": titles})
        return
    table = Table("name", "experiment")
    for name, title in titles.items():
        table.add_row(name, title)
    console.print(table)


@contextmanager
def _progress(parts: int) -> Iterator[Callable[[str], Tell]]:
    """A bar on a terminal, nothing elsewhere. What is told by a part is what begins now."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task, begun = progress.add_task("reproduce", total=parts), 0

        def begin(name: str, words: str) -> None:
            nonlocal begun
            progress.update(task, completed=begun, description=f"{name}: {words}")
            begun += 1

        yield lambda name: lambda words: begin(name, words)


def _write_page(results: Sequence[Result], out: Path) -> Path:
    page = out / PAGE
    page.write_text(import_module("replay.reproduce.tables").page(results), encoding="utf-8")
    return page


def _tell(results: Sequence[Result], page: Path | None, *, json: bool) -> None:
    missed = [f"{result.name}: {row.quantity}" for result in results for row in result.missed]
    if json and page is None:
        print_json(results[0].as_json())
    elif json:
        print_json({"experiments": [result.as_json() for result in results], "page": str(page), "missed": missed})
    else:
        for result in results:
            _show(result)
        if page is not None:
            console.print(f"page {page}", highlight=False)
    for words in missed:
        complain(f"missed: {words}")


def _show(result: Result) -> None:
    tables = import_module("replay.reproduce.tables")
    shown = len(tables.HEADINGS) if console.width >= WIDE else tables.FIGURES  # the rest is in the table's file
    table = Table(*tables.HEADINGS[:shown], title=result.title)
    for row in result.rows:
        table.add_row(*tables.cells(row)[:shown], style="red" if row.missed else None)
    console.print(table)
    for note in result.notes:
        console.print(f"  {note}", highlight=False)
    for words, path in result.sessions.items():
        console.print(f"session, {words}: {path}", highlight=False)
    console.print(f"picture {result.picture}\ntable {result.table}", highlight=False)
