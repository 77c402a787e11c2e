"""A session on one page that needs nothing but itself: no script, no font, no picture from elsewhere.

The template is `page.html` beside this; what stands in it comes from the session and is escaped by Jinja, all of it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from replay.compare.differences import EXPLAINED, Differences
from replay.compare.fleet import Judged
from replay.compare.verify import EXIT_DIFFERENT, EXIT_IDENTICAL, EXIT_INCOMPLETE, Difference
from replay.report import figures
from replay.report.gather import Drive
from replay.report.timing import Latency, Timing
from replay.sessions.summary import Summary

MOST_ROWS = 100  # of a table, what is left out is counted
MOST_LETTERS = 1000  # of a text
PERCENTS = (50.0, 99.0, 99.9)
MEANS = {
    EXIT_IDENTICAL: (
        "This software would do the same again: run once more with the recorded inputs, it gave every CAN frame, mode, "
        "event, reply and odometry of every cycle exactly as it was recorded, and the recording is provably complete."
    ),
    EXIT_DIFFERENT: "This software would not do the same again: with the recorded inputs it said something else.",
    EXIT_INCOMPLETE: (
        "This software would do the same again as far as the recording goes, but something of the recording is missing "
        "or not provably as it was recorded."
    ),
}
NOTHING_COMPARED = "Whether this software would do the same again cannot be told."


class Tile(NamedTuple):
    """A figure that is seen first: its name, value and unit."""

    key: str
    name: str
    value: str
    unit: str = ""


class Few(NamedTuple):
    """What a table has room for, and how much more there is."""

    rows: Sequence[object]
    more: int


def few(rows: Sequence[object]) -> Few:
    """The first of them."""
    return Few(rows[:MOST_ROWS], max(0, len(rows) - MOST_ROWS))


def plain(value: float | None, digits: int = 3) -> str:
    """A number for people."""
    return "unknown" if value is None else f"{value:,.{digits}f}"


def short(text: str) -> str:
    """What of a text there is room for."""
    return text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]}..."


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.globals |= {"few": few, "plain": plain, "short": short}


def page(summary: Summary, judged: Judged, driven: Drive, timing: Timing | None) -> str:
    """As HTML."""
    template = _TEMPLATES.get_template("page.html")
    seconds = summary.seconds
    motion = driven.motion
    return template.render(
        summary=summary,
        judged=judged,
        verdict=judged.verdict,
        means=MEANS.get(judged.verdict.exit_code, NOTHING_COMPARED) if judged.verdict.cycles else NOTHING_COMPARED,
        reasons=_reasons(summary, judged),
        first=_first(judged.verdict.first_difference),
        differences=judged.differences,
        differences_rows=[] if judged.differences is None else _groups(judged.differences),
        explained=EXPLAINED,
        tiles=_tiles(summary, driven),
        timeline=figures.timeline(summary.modes, driven.said, driven.stretches, seconds, driven.gaps),
        map=None if motion is None else figures.from_above(motion.track, motion.drawing),
        plots=[] if motion is None else _plots(driven, seconds),
        histogram=None if timing is None else figures.histogram(timing),
        latencies=[] if timing is None else _latencies(timing),
        fault_rows=[
            (one.level, one.code, f"{one.times:,}", plain(one.t), plain(one.last_t), short(one.text))
            for one in summary.faults
        ],
        command_rows=[
            (one.source, f"{one.commands:,}", *map(plain, (one.t, one.last_t, one.speed, one.turning)))
            for one in driven.said.commanders.values()
        ],
        refused_rows=[(why, f"{times:,}") for why, times in driven.said.refused.items()],
        gap_rows=[(f"{gap.first_cycle:,}", f"{gap.last_cycle:,}", gap.reason) for gap in summary.gaps],
        driven=driven,
    )


def _tiles(summary: Summary, driven: Drive) -> list[Tile]:
    motion = driven.motion
    faults = {level: sum(one.times for one in summary.faults if one.level == level) for level in ("error", "warning")}
    missing = sum(gap.last_cycle - gap.first_cycle + 1 for gap in summary.gaps)
    tiles = [
        Tile("seconds", "duration", f"{summary.seconds:,.3f}", "s"),
        Tile("cycles", "cycles recorded", f"{summary.cycles:,}"),
        Tile("missing", "cycles missing", f"{missing:,}"),
        Tile("received", "frames received", f"{summary.frames_received:,}"),
        Tile("sent", "frames sent", f"{summary.frames_sent:,}"),
        Tile("commanded", "commands heard", f"{sum(one.commands for one in driven.said.commanders.values()):,}"),
        Tile("errors", "errors", f"{faults['error']:,}"),
        Tile("warnings", "warnings", f"{faults['warning']:,}"),
    ]
    if motion is not None:
        tiles.append(Tile("distance", "driven, by odometry", plain(motion.track.distance), "m"))
        tiles.append(Tile("speed", "top speed measured", plain(motion.top_speed), "m/s" if motion.top_speed else ""))
    return tiles


def _reasons(summary: Summary, judged: Judged) -> list[str]:
    """What more there is to say of the verdict."""
    verdict = judged.verdict
    problems = () if verdict.problem is None else (verdict.problem,)
    told = [
        f"Run and compared: {_many(verdict.cycles, 'cycle')} with {_many(verdict.frames, 'sent frame')}.",
        *[f"The recording: {one}." for one in summary.problems or problems],
        "" if verdict.software_change is None else f"The software is another one: {verdict.software_change}.",
        "" if verdict.first_unproven is None else f"Proven are the cycles in front of {verdict.first_unproven:,}.",
        f"Not compared: {verdict.unseen:,} cycles that no recorded state of the core leads to."
        if verdict.unseen
        else "",
        "" if verdict.refused is None else f"A recorded state was of no use: {verdict.refused}.",
    ]
    return [one for one in told if one]


def _many(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _first(difference: Difference | None) -> dict[str, str]:
    if difference is None:
        return {}
    return {
        "cycle": f"{difference.cycle:,}",
        "motor": difference.motor or "of none",
        "field": difference.field,
        "recorded": difference.recorded,
        "replayed": difference.replayed,
    }


def _groups(found: Differences) -> list[tuple[str, ...]]:
    """A row for each motor and field."""
    return [
        (
            *(group.motor or "", group.field),
            *(f"{number:,}" for number in (group.cycles, group.first_cycle, group.last_cycle)),
            "" if group.largest is None else f"{group.largest:.6g}",
        )
        for group in found.groups
    ]


def _plots(driven: Drive, seconds: float) -> list[tuple[str, Sequence[figures.Chart]]]:
    assert driven.motion is not None
    return [
        (plot.title, [figures.chart(panel, driven.stretches, seconds, driven.gaps) for panel in plot.panels])
        for plot in driven.motion.plots
    ]


def _latencies(timing: Timing) -> list[tuple[str, str, list[str]]]:
    names = (("late", "start of a cycle behind its time", timing.late), ("work", "drain, step and send", timing.work))
    return [(name, words, _row(told)) for name, words, told in names]


def _row(told: Latency) -> list[str]:
    return [*(f"{told.below(percent):,.0f}" for percent in PERCENTS), f"{told.most:,.0f}"]
