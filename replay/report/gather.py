"""What a report shows of a session: every cycle of it read and run again, in few enough numbers for a page."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from gateway.chassis.contract import Drawing
from gateway.config import ConfigError, parse
from gateway.types import Inputs
from replay.report.binned import Stretches, stretches_of
from replay.report.plots import Channels, Panel, Plot
from replay.report.said import Said
from replay.report.track import Track
from replay.sessions.cycles import RecordedOutputs
from replay.sessions.reader import Session
from replay.sessions.summary import Summary

PROGRESS_CYCLES = 1000
Tell = Callable[[int], None]


class Motion(NamedTuple):
    """What the core told again. `silent`: plots of which nothing is known. `top_speed`: m/s, None: not measured."""

    plots: Sequence[Plot]
    silent: Sequence[str]
    track: Track
    drawing: Drawing
    top_speed: float | None


class Drive(NamedTuple):
    """A whole session. `gaps`: what is missing between its cycles, from and to, s.

    `motion`: None where this software cannot run it, `refused` says why.
    """

    stretches: Stretches
    said: Said
    gaps: Sequence[tuple[float, float]]
    motion: Motion | None
    refused: str | None


def drive(session: Session, summary: Summary, tell: Tell | None = None) -> Drive:
    """Read and run every cycle. `tell` is told how many more are done."""
    channels, refused = None, None
    try:
        config = parse(session.config_text, "robot file of the session")
        channels = Channels(config, session, summary.seconds, summary.cycles)
    except ConfigError as error:
        refused = str(error)
    stretches = stretches_of(summary.seconds, summary.cycles, 1) if channels is None else channels.stretches
    said, gaps, last = Said(stretches), [], None
    for t, inputs, recorded in _timed(session, tell):
        said.add(t, inputs, recorded)
        if last is not None and inputs.cycle != last[0] + 1:
            gaps.append((last[1], t))
        last = inputs.cycle, t
        if channels is not None:
            if gaps and gaps[-1][1] == t:
                channels.track.part()
            channels.add(t, inputs, recorded.mode)
    return Drive(stretches, said, gaps, None if channels is None else _motion(channels), refused)


def _timed(session: Session, tell: Tell | None) -> Iterator[tuple[float, Inputs, RecordedOutputs]]:
    """Each cycle with its time since the first one, s."""
    first_ns = None
    for done, (inputs, recorded) in enumerate(session.cycles(), start=1):
        first_ns = inputs.now_ns if first_ns is None else first_ns
        yield (inputs.now_ns - first_ns) * 1e-9, inputs, recorded
        if tell is not None and done % PROGRESS_CYCLES == 0:
            tell(PROGRESS_CYCLES)


def _motion(channels: Channels) -> Motion:
    plots = channels.finish()
    told = [plot._replace(panels=[panel for panel in map(_told, plot.panels) if panel.series]) for plot in plots]
    return Motion(
        plots=[plot for plot in told if plot.panels],
        silent=[plot.title for plot in told if not plot.panels],
        track=channels.track,
        drawing=channels.drawing,
        top_speed=channels.top_speed,
    )


def _told(panel: Panel) -> Panel:
    return panel._replace(series=[one for one in panel.series if one.told])
