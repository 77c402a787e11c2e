"""What codes mean: `drivegate doctor --explain CODE`."""

import typer

from gateway import words
from gateway.cli.output import complain, console, print_json
from gateway.guess import guess

EXIT_UNKNOWN = 1
ALL = "all"


def tell_code(code: str, *, json: bool) -> None:
    """The entries for a code, or all there are; exit 1 for one that is none."""
    found = words.every() if code == ALL else words.explain(code)
    if not found:
        complain(
            f"{code!r} is no code of ours and no vendor's word{guess(code, words.codes())}; `all` prints every one"
        )
        raise typer.Exit(EXIT_UNKNOWN)
    if json:
        print_json({"codes": [{"table": one.table, "code": one.code, **one.words._asdict()} for one in found]})
        return
    for one in found:
        _show(one)


def _show(one: words.Explanation) -> None:
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
