"""A session on one page that needs nothing but itself: no script, no font, no picture from elsewhere."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import numpy as np

from gateway.recording.packets import Gap
from replay.compare.fleet import Judged
from replay.report import drawing
from replay.report.gather import Drive, Timing
from replay.sessions.summary import Fault, Summary

MOST_ROWS = 100  # of a table; what is left out is counted


def page(summary: Summary, judged: Judged, drive: Drive | None, timing: Timing | None) -> str:
    """As HTML. `drive`: None where this software refuses the robot file."""
    parts = [
        _head(summary),
        _verdict(summary, judged),
        *(() if drive is None else _drive(summary, drive)),
        _faults(summary.faults),
        _latency(timing),
        _software(summary),
    ]
    return _PAGE.replace("@title@", escape(f"{summary.robot}, {summary.session}")).replace("@body@", "\n".join(parts))


def _head(summary: Summary) -> str:
    kind = [
        f"simulated by {summary.plant}" if summary.plant else "",
        f"imported from {summary.imported}" if summary.imported else "",
        f"a piece of {summary.cut_from}" if summary.cut_from else "",
    ]
    told = [summary.began or "nothing was recorded", f"{summary.seconds:.3f} s", f"{summary.cycles:,} cycles"]
    told += [f"{summary.frames_received:,} frames received, {summary.frames_sent:,} sent", *filter(None, kind)]
    return f"<h1>{escape(summary.robot)}</h1><p><code>{escape(summary.session)}</code></p>{_list(told)}"


def _verdict(summary: Summary, judged: Judged) -> str:
    verdict = judged.verdict
    covered = f"{verdict.cycles:,} cycles and {verdict.frames:,} sent frames were compared with what this software says"
    parts = [f"<b>{escape(judged.word)}</b><p>{covered}</p>"]
    difference = verdict.first_difference
    if difference is not None:
        motor = f" of motor {difference.motor}" if difference.motor else ""
        told = {
            "first difference": f"cycle {difference.cycle}: {difference.field}{motor}",
            "recorded": difference.recorded,
            "replayed": difference.replayed,
        }
        parts.append(_facts(told))
    told_more = [
        "" if verdict.software_change is None else f"the software is another one: {verdict.software_change}",
        "" if verdict.complete or summary.problems or verdict.problem is None else verdict.problem,
        "" if verdict.first_unproven is None else f"proven are the cycles in front of {verdict.first_unproven}",
        f"not compared: {verdict.unseen} cycles that no snapshot leads to" if verdict.unseen else "",
        "" if verdict.refused is None else f"a snapshot was of no use: {verdict.refused}",
    ]
    parts.append(_list(filter(None, told_more)))
    if not summary.complete:
        parts.append("<p>The recording is incomplete:</p>" + _list(_few(summary.problems)))
    kind = judged.word.replace(" ", "-")
    return f'<section class="verdict {escape(kind)}" id="verdict">{"".join(parts)}</section>{_gaps(summary.gaps)}'


def _gaps(gaps: Sequence[Gap]) -> str:
    if not gaps:
        return ""
    rows = [(f"{gap.first_cycle}", f"{gap.last_cycle}", str(gap.reason)) for gap in gaps]
    return _section("gaps", "Not recorded", _table(("first cycle", "last cycle", "why"), rows))


def _drive(summary: Summary, drive: Drive) -> list[str]:
    seconds = summary.seconds
    words = f"Time in s since the first recorded cycle. {_downsampled(drive)}"
    if drive.gaps:
        words += " Shaded: not recorded."
    parts = [_section("timeline", "Modes and faults", drawing.timeline(summary.modes, drive.events, seconds, drive.gaps))]
    if drive.way is None:
        parts.append(_section("path", "Path from above", "<p>No pose was told.</p>"))
    else:
        note = f"<p>x to the right, y up, m; from the ring to the dot; drawn to within {1e3 * drive.way.within:.2g} mm.</p>"
        parts.append(_section("path", "Path from above", drawing.way(drive.way) + note))
    parts.append(f'<p class="note" id="downsampled">{escape(words)}</p>')
    for number, one in enumerate(drive.plots):
        parts.append(_section(f"plot-{number}", one.title, drawing.plot(one, drive.times, seconds, drive.gaps)))
    if drive.silent:
        parts.append(f'<p class="note">Nothing was told of: {escape(", ".join(drive.silent))}.</p>')
    return parts


def _downsampled(drive: Drive) -> str:
    return (
        f"Drawn are the least and the greatest value of each {1e3 * drive.stretch:.3g} ms, joined by lines: no peak is "
        "left out, what is between two of them is. Dashed: what was asked for."
    )


def _faults(faults: Sequence[Fault]) -> str:
    if not faults:
        return _section("faults", "Faults and warnings", "<p>None.</p>")
    head = ("level", "code", "times", "first, s", "last, s", "first words")
    rows = [(one.level, one.code, f"{one.times}", f"{one.t:.3f}", f"{one.last_t:.3f}", one.text) for one in faults]
    return _section("faults", "Faults and warnings", _table(head, rows))


def _latency(timing: Timing | None) -> str:
    title = "Latency of the loop"
    if timing is None:
        return _section("latency", title, "<p>Not told by this recording.</p>")
    rows = [
        (name, *(f"{value:.1f}" for value in (*np.percentile(values, (50, 99, 99.9)), values.max())))
        for name, values in (("late: start behind its time", timing.late), ("work: drain, step, send", timing.work))
    ]
    table = _table(("us", "median", "99 %", "99.9 %", "most"), rows)
    note = f"<p>Cycles by latency, of all {len(timing.late):,}; both axes logarithmic.</p>"
    return _section("latency", title, drawing.histogram(timing) + note + table)


def _software(summary: Summary) -> str:
    told = {
        "commit": summary.commit or "not told",
        **summary.versions,
        "host": summary.host,
        "robot file": summary.config_origin,
        "schema of the recording": str(summary.schema),
    }
    return _section("software", "Robot and versions", _facts(told))


def _section(name: str, title: str, body: str) -> str:
    return f'<section id="{name}"><h2>{escape(title)}</h2>{body}</section>'


def _few(words: Sequence[str]) -> list[str]:
    more = len(words) - MOST_ROWS
    return [*words[:MOST_ROWS], *([f"and {more} more"] if more > 0 else [])]


def _list(words: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(one)}</li>" for one in words)
    return f"<ul>{items}</ul>" if items else ""


def _facts(told: Mapping[str, str]) -> str:
    return _table((), list(told.items()))


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(one)}</th>" for one in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[:MOST_ROWS]
    )
    more = f"<p>and {len(rows) - MOST_ROWS} more</p>" if len(rows) > MOST_ROWS else ""
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>{more}'


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>@title@</title>
<style>
:root { color-scheme: light dark; --page: #fff; --ink: #1b1b1b; --soft: #5c6670; --grid: #dde1e6; --gap: #d0d4da;
  --good: #1a7f37; --bad: #c62828; --unsure: #946200;
  --c0: #1f66c1; --c1: #d2560a; --c2: #1d8a3e; --c3: #b3261e; --c4: #7b4fc4; --c5: #7a5040; --c6: #c2358f; --c7: #0b7f8c; }
@media (prefers-color-scheme: dark) {
  :root { --page: #14171b; --ink: #e6e9ed; --soft: #a3adb8; --grid: #2f363e; --gap: #3d4650;
  --good: #57c878; --bad: #ff7b72; --unsure: #e3b341;
  --c0: #6cb0ff; --c1: #ff9f5a; --c2: #66d38a; --c3: #ff8a80; --c4: #bfa0ff; --c5: #d0a890; --c6: #ff8fd0; --c7: #5fd4e0; }
}
body { font: 15px/1.45 system-ui, sans-serif; max-width: 100rem; margin: 1.5rem auto; padding: 0 1rem;
  color: var(--ink); background: var(--page); }
h1 { margin-bottom: 0; } h2 { font-size: 1.1rem; margin: 1.6rem 0 .4rem; }
code, td { overflow-wrap: anywhere; }
.note { color: var(--soft); }
.verdict { border-left: .5rem solid var(--unsure); padding: .2rem 1rem; }
.verdict > b { font-size: 1.3rem; color: var(--unsure); }
.verdict.identical { border-color: var(--good); } .verdict.identical > b { color: var(--good); }
.verdict.different { border-color: var(--bad); } .verdict.different > b { color: var(--bad); }
table { border-collapse: collapse; font-size: 13px; }
th, td { text-align: left; padding: .25rem .8rem .25rem 0; border-bottom: 1px solid var(--grid); vertical-align: top; }
.wide { overflow-x: auto; }
svg { width: 100%; height: auto; display: block; }
svg text { fill: var(--soft); font: 12px system-ui, sans-serif; }
.on text { fill: #fff; }
.grid { stroke: var(--grid); fill: none; }
.line { fill: none; stroke-width: 1.4; stroke-linejoin: round; }
.line.asked { stroke-dasharray: 5 3; opacity: .65; }
.c0 { --c: var(--c0); } .c1 { --c: var(--c1); } .c2 { --c: var(--c2); } .c3 { --c: var(--c3); }
.c4 { --c: var(--c4); } .c5 { --c: var(--c5); } .c6 { --c: var(--c6); } .c7 { --c: var(--c7); }
.line { stroke: var(--c); } .bar { fill: var(--c); }
.gap { fill: var(--gap); }
.begin { fill: none; stroke: var(--ink); stroke-width: 2; } .end { fill: var(--ink); }
.event { stroke-width: 2; stroke: var(--unsure); } .event.error { stroke: var(--bad); }
.m-idle { fill: #6b7580; } .m-starting { fill: #7b5a00; } .m-drive { fill: #1a6e34; } .m-degraded { fill: #a04a00; }
.m-stopping { fill: #205ea8; } .m-estop { fill: #b3261e; } .m-fault { fill: #8e1550; } .m-other { fill: #444; }
.keys { margin: .2rem 0 0; font-size: 13px; }
.keys span { display: inline-block; margin-right: 1.2rem; }
.keys i { display: inline-block; width: 1.4rem; border-top: 3px solid var(--c); margin-right: .4rem; vertical-align: .25em; }
.keys i.asked { border-top-style: dashed; }
@media (min-width: 70rem) { body { font-size: 16px; } }
@media print { section { break-inside: avoid; } }
</style></head><body>
@body@
</body></html>
"""
