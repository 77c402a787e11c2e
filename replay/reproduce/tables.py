"""Tables for people: Markdown beside a picture, and one HTML page that has everything in it."""

import base64
from collections.abc import Sequence
from html import escape
from math import inf, isfinite

from replay.reproduce.result import Result, Row

HEADINGS = ("quantity", "unit", "paper", "ours", "difference", "allowed", "note")
FIGURES = 5  # of them that are figures


def cells(row: Row) -> tuple[str, ...]:
    """As they are shown, in the order of HEADINGS."""
    difference = "" if row.difference is None else f"{row.difference:+.1%}"
    return (row.quantity, row.unit, _number(row.paper), _number(row.ours), difference, _allowed(row), row.note)


def markdown(result: Result) -> str:
    """Table, notes and sessions."""
    lines = [f"# {result.title}", "", f"![{result.name}]({result.picture.name})", ""]
    lines += ["| " + " | ".join(HEADINGS) + " |", "|" + "---|" * len(HEADINGS)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in cells(row)) + " |" for row in result.rows]
    lines += ["", *(f"- {note}" for note in result.notes), ""]
    lines += [f"Session, {words}: `{path}`" for words, path in result.sessions.items()]
    return "\n".join(lines) + "\n"


def page(results: Sequence[Result]) -> str:
    """One HTML page, pictures included. Raises OSError where one cannot be read."""
    missed = sum(len(result.missed) for result in results)
    summary = f"{missed} rows miss what they are allowed" if missed else "every row is within what it is allowed"
    contents = "".join(f'<li><a href="#{one.name}">{escape(one.title)}</a></li>' for one in results)
    sections = "".join(_section(result) for result in results)
    return _PAGE.format(summary=summary, contents=contents, sections=sections)


def _section(result: Result) -> str:
    image = base64.b64encode(result.picture.read_bytes()).decode("ascii")
    head = "".join(f"<th>{heading}</th>" for heading in HEADINGS)
    rows = "".join(_row(row) for row in result.rows)
    notes = "".join(f"<li>{escape(note)}</li>" for note in result.notes)
    sessions = "".join(
        f"<li>{escape(words)}: <code>{escape(str(path))}</code></li>" for words, path in result.sessions.items()
    )
    return (
        f'<section id="{result.name}"><h2>{escape(result.title)} <code>{result.name}</code></h2>'
        f'<img alt="{escape(result.title)}" src="data:image/png;base64,{image}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        f"<ul>{notes}</ul><details><summary>sessions</summary><ul>{sessions}</ul></details></section>\n"
    )


def _row(row: Row) -> str:
    told = "".join(f"<td>{escape(cell)}</td>" for cell in cells(row))
    return f'<tr class="missed">{told}</tr>' if row.missed else f"<tr>{told}</tr>"


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isfinite(value) else "never"


def _allowed(row: Row) -> str:
    if row.allowed is None:
        return ""
    low, high = row.allowed
    told = f"{low:.5g} to {high:.5g}" if high < inf else f"at least {low:.5g}"
    return f"{told}: missed" if row.missed else told


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>The experiments of the papers, run again</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; color: #1b1b1b;
  background: #fff; }}
img {{ width: 100%; height: auto; }}
table {{ border-collapse: collapse; width: 100%; font-size: 13px; }}
th, td {{ text-align: left; padding: .25rem .5rem; border-bottom: 1px solid #ddd; vertical-align: top; }}
td:nth-child(3), td:nth-child(4), td:nth-child(5) {{ text-align: right; white-space: nowrap; }}
tr.missed {{ background: #fde0e0; }}
section {{ margin-top: 3rem; }}
</style></head><body>
<h1>The experiments of the papers, run again</h1>
<p>preprints202312.1327, <cite>Driving Strategies for Omnidirectional Mobile Robots with Offset Differential
Wheels</cite> (moby); Rojas, <cite>Omnidirectional Control</cite>, 2005 (rojas); Amarasiri, Barhorst and Gottumukkala,
ASME Letters in Dynamic Systems and Control 2(4), 040902, 2022 (kane); Zhao, Xie and Meng, <cite>ODD: Omni Differential
Drive</cite>, arXiv 2412.10773 (odd). <b>{summary}.</b> A dash under "paper": the paper
does not print it. "Service": through command, engine, CAN, simulated controllers and plant, recorded; all else is
computed directly.</p>
<ul>{contents}</ul>
{sections}</body></html>
"""
