"""`drivegate setup tune`: gains of the host's speed loop, from how a motor answers small steps."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table

from gateway.cli.asking import NotAllowedError, Yes, allow
from gateway.cli.correcting import OwnFile, correct
from gateway.cli.output import console, errors, print_json
from gateway.cli.refusing import refuse
from gateway.cli.rewriting import RewriteError, drafted
from gateway.cli.setup_jog import look_for_bus, run, warning, words
from gateway.config import ConfigError, RobotConfig, load
from gateway.core.examination import carried_inertia, examine_text
from gateway.edges.can_adapter import AdapterError
from gateway.setup.correction import Change, CorrectionError, corrected
from gateway.setup.excitation import Excitation
from gateway.setup.jog import Ending, JogError
from gateway.setup.words import positive_ways

if TYPE_CHECKING:
    from replay.identify.tuning import Tuned

_TOO_WEAK = "; if it is free to turn, speed_loop.kp of the robot file is too weak for its friction: raise it"
_TOO_STRONG = (
    "; if its phases and its direction are right, speed_loop.kp of the robot file is too strong: a tenth of it"
)
_ADVICE = {Ending.STUCK: _TOO_WEAK, Ending.RUNAWAY: _TOO_STRONG}
PICTURE: Final = ".png"


class TuneError(RuntimeError):
    """Why there are no gains; the robot file is as it was."""


def tune(
    file: OwnFile,
    motor: Annotated[str, typer.Argument(help="Its name in the robot file.")],
    plot: Annotated[Path | None, typer.Option(help="Picture of the fit and of both loops, e.g. tune.png.")] = None,
    yes: Yes = False,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Turn one motor by small steps of speed, wheel off the ground, and write the gains that its answer asks for.

    For a motor whose speed loop is on the host (C620, C610, GM6020). Inertia, friction and delay are found by least
    squares; kp and ki follow by a rule that leaves a phase margin of 60 deg and a gain margin of 3 for every load
    between a wheel in the air and one that carries its share of the robot. They are shown, and written after a yes.
    """
    config, text = load(file)
    try:
        if plot is not None and plot.suffix.lower() != PICTURE:
            raise TuneError(f"--plot {plot}: must end in {PICTURE}, so that no other file becomes a picture")
        procedure = Excitation(config, motor)
        look_for_bus(config, procedure.bus)
        with drafted(file, text):
            pass  # so that nothing turns for nothing
        allow(
            f"{warning(config, motor)} {motor} will turn {procedure.way:.2f} rad by steps of speed, at "
            f"{procedure.top:g} rad/s at most: {positive_ways(config.robot)[motor]}.",
            "to turn it",
            yes=yes,
        )
        tuned = _tuned(config, motor, procedure)
        new = _changes(motor, tuned)
        _check(file, text, corrected(text, new, str(file)))
        if not json:
            _show(motor, tuned)
        if plot is not None:
            import_module("gateway.cli.tune_picture").draw_tuned(motor, tuned, plot)
        kept = correct(file, text, new, yes=yes)
    except (
        *(TuneError, JogError, CorrectionError, RewriteError, NotAllowedError, ConfigError, OSError, AdapterError),
        KeyboardInterrupt,
    ) as error:
        refuse(error, json=json, unchanged=file)
    if json:
        print_json({"ok": True, **_document(motor, tuned), "kept": kept and str(kept)})


def _tuned(config: RobotConfig, motor: str, procedure: Excitation) -> "Tuned":
    """Turns it, and what follows. Raises TuneError. Only here SciPy is imported: it takes a third of a second."""
    outcome = run(config, procedure)
    if not outcome.well:
        raise TuneError(words(outcome) + _ADVICE.get(outcome.ending, ""))
    module, response = import_module("replay.identify.tuning"), import_module("replay.identify.response")
    loop = next(one.speed_loop for one in config.motor if one.name == motor)
    with errors.status("identifying"):
        try:
            tuned: Tuned = module.tune(
                procedure.told,
                before=loop,
                carried=carried_inertia(config),
                damping=procedure.damping,
                period=1.0 / config.loop.rate,
            )
        except response.ResponseError as error:
            raise TuneError(f"{motor}: {error}") from None
    return tuned


def _check(file: Path, old: str, new: str) -> None:
    """Raises TuneError where the robot file would have a problem that it has not: it may be tuned for those it has."""
    more = [problem for problem in _problems(file, new) if problem not in _problems(file, old)]
    if more:
        raise TuneError("; ".join(more))


def _problems(file: Path, text: str) -> tuple[str, ...]:
    try:
        examine_text(text, str(file))
    except ConfigError as error:
        return error.problems
    return ()


def _changes(motor: str, tuned: "Tuned") -> list[Change]:
    return [
        Change(motor, f"speed_loop.{key}", old, new)
        for key, old, new in zip(tuned.after._fields, tuned.before, tuned.after, strict=True)
        if old != new
    ]


def _show(motor: str, tuned: "Tuned") -> None:
    found = Table("found", "value", "95 %", title=f"{motor}: {tuned.answer.explained:.1%} of its speed explained")
    for name, value, half in zip(_UNITS, tuned.answer.response, tuned.answer.halves, strict=True):
        found.add_row(name, f"{value:.4g}", f"+- {half:.2g}", _UNITS[name])
    console.print(found)
    loops = Table("loop", "kp", "ki", "load", "phase margin", "gain margin", "crossover")
    for loop, gains, inertia, margins in tuned.rows():
        loops.add_row(
            *(loop, f"{gains.kp:g}", f"{gains.ki:g}", f"{inertia:.3g} kg m^2"),
            *(f"{margins.phase:.0f} deg", f"{margins.gain:.1f}", f"{margins.crossover:.3g} rad/s"),
        )
    console.print(loops)


_UNITS = {"inertia": "kg m^2", "friction": "N m per rad/s", "drag": "N m", "delay": "s"}


def _document(motor: str, tuned: "Tuned") -> dict[str, object]:
    answer = tuned.answer
    found = {
        name: {"value": value, "half": half}
        for name, value, half in zip(_UNITS, answer.response, answer.halves, strict=True)
    }
    loops = [
        {"loop": loop, **gains._asdict(), "inertia": inertia, **margins._asdict()}
        for loop, gains, inertia, margins in tuned.rows()
    ]
    return {"motor": motor, "found": found, "explained": answer.explained, "loops": loops}
