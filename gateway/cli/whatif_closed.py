"""`drivegate replay whatif --closed`: the recorded commands once more on the simulated robot, unchanged and changed."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Protocol

from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from gateway.cli.output import complain, console, errors, print_json
from gateway.cli.replay_identify import found_in
from gateway.config import RobotConfig, parse
from replay.compare.likeness import Comparison
from replay.compare.verify import EXIT_INCOMPLETE
from replay.compare.what_if import Change, WhatIfError
from replay.identify.closed import CLOSED_LOOP, SENSED, ClosedLoopWhatIf, Sides
from replay.identify.parameters import IdentifyError, ParameterFile, read_parameters
from replay.sessions.reader import Session
from replay.sim.plants.contract import PlantName

EXIT_NOT_TO_BE_TRUSTED = 1
SHOWN = 20  # changes, the first ones
PROGRESS_CYCLES = 250


def closed_loop(  # what the command line has
    session: Session,
    settings: Mapping[str, float],
    other: RobotConfig | None,
    begin: float,
    *,
    parameters: Path | None,
    plant: PlantName | None,
    out: Path | None,
    json: bool,
) -> int:
    """Tell it; the exit code. Raises SessionError, ConfigError, WhatIfError, OSError."""
    try:
        known = _parameters(session, parameters, plant)
    except IdentifyError as error:
        raise WhatIfError(str(error)) from None
    question = ClosedLoopWhatIf(session, known, settings, other, begin)
    with _recording(question, out) as recording, _progress(question.drive.cycles) as progress:
        for step in question.steps():
            if recording is not None:
                recording.add(step)
            if step.cycle % PROGRESS_CYCLES == 0:
                progress(step.cycle)
    if json:
        print_json(_document(question, known, session.problem))
    else:
        _show(question, known)
    if question.reproduced.reasons:
        return EXIT_NOT_TO_BE_TRUSTED
    if session.problem is not None:
        complain(f"{session.path}: incomplete: {session.problem}")
        return EXIT_INCOMPLETE
    return 0


def _parameters(session: Session, path: Path | None, plant: PlantName | None) -> ParameterFile:
    """Of the file, or identified from the same session. Raises IdentifyError, SessionError, ConfigError, OSError."""
    if path is None:
        found: ParameterFile = found_in(session, plant, ()).file
        return found
    return read_parameters(path, parse(session.config_text, f"robot file of {session.path}"))


class _Recorder(Protocol):
    """Takes every step."""

    def add(self, step: Sides) -> None: ...


def _recording(question: ClosedLoopWhatIf, out: Path | None) -> AbstractContextManager[_Recorder | None]:
    if out is None:
        return nullcontext()
    from gateway.cli.whatif_recording import Recording  # noqa: PLC0415  # Rerun takes half a second

    old, new = question.drive.config, question.new_config
    return Recording(out, question.drive.name, {"recorded": old, "predicted": old, "changed": new})


@contextmanager
def _progress(cycles: int) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal, nothing elsewhere."""
    columns = (TextColumn("driving"), BarColumn(), TextColumn("{task.completed:.0f} cycles"), TimeRemainingColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("drive", total=cycles)
        yield lambda done: progress.update(task, completed=done)


def _document(question: ClosedLoopWhatIf, known: ParameterFile, problem: str | None) -> dict[str, object]:
    return {
        "changes": [change._asdict() for change in question.changes],
        "cycles": question.cycles,
        "reproduced": question.reproduced.as_json(),
        "effect": question.effect.as_json(),
        "parameters": known.values,
        "plant": known.plant,
        "closed_loop": CLOSED_LOOP,
        "sensed": question.drive.sensed,
        "problem": problem,
    }


def _show(question: ClosedLoopWhatIf, known: ParameterFile) -> None:
    reproduced, effect = question.reproduced, question.effect
    table = Table("what", "recorded settings against the recording", "change against recorded settings")
    for words, read in _ROWS:
        table.add_row(words, read(reproduced), read(effect))
    console.print(table)
    changes = question.changes
    if changes:
        _show_changes(changes)
    else:
        console.print("[green]nothing changes[/]")
    found = ", ".join(f"{name} {value:.4g}" for name, value in known.values.items())
    console.print(f"  {question.cycles} cycles, plant {known.plant}: {found}", highlight=False)
    console.print(f"  {CLOSED_LOOP}", highlight=False)
    if question.drive.sensed:
        console.print(f"  [yellow]{SENSED}[/]", highlight=False)
    if reproduced.reasons:
        complain(
            "not to be trusted: with the recorded settings the simulated robot does not drive as it was recorded: "
            + "; ".join(reproduced.reasons)
        )


def _show_changes(changes: list[Change]) -> None:
    table = Table("motor", "what", "cycles", "first", "largest", "at", "rms", title="what changes")
    for one in changes[:SHOWN]:
        sizes = (_number(one.largest), _number(one.largest_t, " s"), _number(one.rms))
        table.add_row(one.motor or "", one.channel, str(one.cycles), _number(one.first_t, " s"), *sizes)
    console.print(table)
    if len(changes) > SHOWN:
        console.print(f"  and {len(changes) - SHOWN} more: --json", highlight=False)


_ROWS: tuple[tuple[str, Callable[[Comparison], str]], ...] = (
    ("pose at the end", lambda one: f"{one.end_m:.3f} m, {one.end_rad:.3f} rad"),
    ("path", lambda one: f"{one.largest_m:.3f} m at most, of {one.path_m:.2f} m"),
    ("wheel speeds (rms)", lambda one: f"{100.0 * one.wheels_rms:.2f} % of the top speed"),
    ("modes", lambda one: "the same" if _same_modes(one) else f"{' '.join(one.modes_redriven)}"),
)


def _same_modes(one: Comparison) -> bool:
    return one.modes_recorded == one.modes_redriven[: len(one.modes_recorded)]


def _number(value: float | None, unit: str = "") -> str:
    return "" if value is None else f"{value:.4g}{unit}"
