"""`drivegate explain`: what a key of the robot file means, or a code; the latter is in `doctor --explain` too."""

from collections.abc import Sequence
from typing import Annotated

import typer

from gateway import words
from gateway.cli.output import complain, console, print_json
from gateway.file_keys import Rule
from gateway.guess import guess

EXIT_UNKNOWN = 1
ALL = "all"


def explain(
    word: Annotated[str, typer.Argument(help="Key of the robot file (limits.motor_speed), or a code (fault_stall).")],
    json: Annotated[bool, typer.Option("--json", help="Machine-readable answer.")] = False,
) -> None:
    """Say what a key of the robot file means, its unit, range and default; or what a code means, and what to do."""
    from gateway.config import RobotConfig  # noqa: PLC0415  # not needed for a code
    from gateway.file_keys import matching, rules  # noqa: PLC0415

    every = list(rules(RobotConfig))
    found = matching(every, word)
    if not found:
        tell_code(word, json=json, others=[rule.key for rule in every])
    elif json:
        print_json({"keys": [document(rule) for rule in found]})
    else:
        for rule in found:
            show(rule)


def document(rule: Rule) -> dict[str, object]:
    """For programs."""
    return rule._asdict() | {"required": rule.default is None}


def show(rule: Rule) -> None:
    """A key in two lines."""
    kind = "" if rule.chassis is None else f" (of {rule.chassis})"
    console.print(f"{rule.key}{kind}", style="bold", markup=False, highlight=False, end="")
    _line(f"  {rule.allowed}; {rule.needed}")
    _line(f"    {rule.meaning}{_names(rule.key)}")


def _names(key: str) -> str:
    """The drivers there are, where a key names one."""
    from drivers import DRIVERS  # noqa: PLC0415
    from drivers.sensors import SENSORS  # noqa: PLC0415

    known = {
        "motor.driver": list(DRIVERS),
        "motor.variant": [f"{name} {', '.join(driver.variants)}" for name, driver in DRIVERS.items()],
        "sensor.driver": list(SENSORS),
    }.get(key)
    return "" if known is None else f": there is {'; '.join(known)}"


def tell_code(code: str, *, json: bool, others: Sequence[str] = ()) -> None:
    """The entries for a code, or all there are; exit 1 for none. `others`: what else may have been meant."""
    found = words.every() if code == ALL else words.explain(code)
    if not found:
        also = ", no key of the robot file" if others else ""
        known = [*others, *(key.rpartition(".")[2] for key in others), *words.codes()]
        complain(f"{code!r} is no code of ours{also} and no vendor's word (`doctor --explain all`){guess(code, known)}")
        raise typer.Exit(EXIT_UNKNOWN)
    if json:
        print_json({"codes": [{"table": one.table, "code": one.code, **one.words._asdict()} for one in found]})
        return
    for one in found:
        _show_code(one)


def _show_code(one: words.Explanation) -> None:
    console.print(f"{one.code} ({words.TITLES[one.table]})", style="bold", markup=False, highlight=False)
    _line(f"  {one.words.meaning}")
    for title, lines in (("likely causes, the likeliest first", one.words.causes), ("what to do", one.words.cures)):
        if lines:
            _line(f"  {title}:")
        for place, line in enumerate(lines, 1):
            _line(f"    {place}. {line}")
    _line("")


def _line(text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
