"""What a report shows of a session: every cycle of it run again, in few enough numbers for a page.

Modes and events are those that were recorded; channels are computed again from the recorded inputs, as in
`replay.compare.retrace`, and are unknown where no recorded state of the core leads.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from gateway.config import RobotConfig, parse
from gateway.core.channels import Channel, Layout, channels_of, owners
from gateway.types import Inputs, Level
from replay.compare.replay import CRASHES, Replay
from replay.report.binned import Binned, Numbers
from replay.sessions.cycles import RecordedOutputs
from replay.sessions.reader import Session, SessionError
from replay.sessions.summary import Summary

MOST_BINS = 1000
CYCLES_PER_BIN = 2  # at the least, so that none is empty because a cycle came late
PATH_POINTS = 8000
FINEST = 2000.0  # of the extent of a path: what nobody sees
PROGRESS_CYCLES = 1000
BREAK_S = 1.0  # a pose that comes later than that after the last one is not joined to it
_NOWHERE = (np.nan, np.nan)


class Series(NamedTuple):
    """A channel over time: least and greatest of each stretch, NaN where it is unknown."""

    label: str
    low: Numbers
    high: Numbers
    asked: bool


class Plot(NamedTuple):
    """Channels that are looked at together; `title` with unit."""

    title: str
    series: Sequence[Series]


class Way(NamedTuple):
    """From above, m: NaN parts its pieces. `within`: no pose of the core is further than that from a drawn one."""

    x: Numbers
    y: Numbers
    within: float


class Happened(NamedTuple):
    """Events of a code: when each came, s."""

    level: str
    code: str
    times: Sequence[float]


class Timing(NamedTuple):
    """How the loop kept time, us of each cycle."""

    late: Numbers
    work: Numbers


class Drive(NamedTuple):
    """Of a whole session. `times`: the middles of the stretches, each `stretch` long, s. `gaps`: from, to, s."""

    times: Numbers
    stretch: float
    plots: Sequence[Plot]
    way: Way | None
    events: Sequence[Happened]
    gaps: Sequence[tuple[float, float]]
    unseen: int
    silent: Sequence[str]  # plots of which nothing was told


class _Gathering:
    """Takes cycle after cycle."""

    def __init__(self, config: RobotConfig, session: Session, summary: Summary) -> None:
        self.channels = [channel for channel in channels_of(config) if channel.plot]
        self.layout = Layout(owners(config), self.channels)
        self.replay = Replay(config, session.snapshot)
        size = max(1, min(MOST_BINS, summary.cycles // CYCLES_PER_BIN))
        self.binned = Binned(summary.seconds, size, len(self.layout.labels))
        self.poses: list[tuple[float, float]] = []
        self.gaps: list[tuple[float, float]] = []
        self.events: dict[tuple[str, str], list[float]] = {}
        self._first_ns: int | None = None
        self._last: tuple[int, float] | None = None  # cycle and time
        self._posed = 0.0

    def add(self, inputs: Inputs, recorded: RecordedOutputs) -> None:
        self._first_ns = inputs.now_ns if self._first_ns is None else self._first_ns
        t = (inputs.now_ns - self._first_ns) * 1e-9
        if self._last is not None and inputs.cycle != self._last[0] + 1:
            self.gaps.append((self._last[1], t))
        self._last = (inputs.cycle, t)
        for event in recorded.events:
            if event.level is not Level.INFO:
                self.events.setdefault((event.level.value, event.code), []).append(t)
        self._run(t, inputs)

    def _run(self, t: float, inputs: Inputs) -> None:
        engine = self.replay.engine(inputs)
        if engine is None:
            return
        try:
            trace = engine.step(inputs).trace
        except CRASHES:  # the verdict says so
            self.replay.lose()
            return
        self.binned.add(t, self.layout.row(trace))
        if trace.pose is not None:
            if t - self._posed > BREAK_S:
                self.poses.append(_NOWHERE)
            self._posed = t
            place = (trace.pose[0], trace.pose[1])
            if not self.poses or self.poses[-1] != place:
                self.poses.append(place)


def drive(session: Session, summary: Summary, progress: Callable[[int], None] | None = None) -> Drive:
    """Run every cycle once more. `progress` is told how many more are done. Raises ConfigError."""
    gathering = _Gathering(parse(session.config_text, "robot file of the session"), session, summary)
    for done, (inputs, recorded) in enumerate(session.cycles(), start=1):
        gathering.add(inputs, recorded)
        if progress is not None and done % PROGRESS_CYCLES == 0:
            progress(PROGRESS_CYCLES)
    gathering.binned.finish()
    plots = _plots(gathering)
    told = [Plot(plot.title, [one for one in plot.series if _is_told(one)]) for plot in plots]
    return Drive(
        times=gathering.binned.times,
        stretch=gathering.binned.width,
        plots=[plot for plot in told if plot.series],
        way=_way(gathering.poses),
        events=[Happened(level, code, times) for (level, code), times in gathering.events.items()],
        gaps=gathering.gaps,
        unseen=gathering.replay.unseen,
        silent=[plot.title for plot in told if not plot.series],
    )


def timing(session: Session) -> Timing | None:
    """None where the recording is of the first schema, which is not read for that, or has none."""
    try:
        found = [(one.late_ns, one.work_ns) for _, one in session.timings()]
    except SessionError:
        return None
    if not found:
        return None
    late, work = np.array(found, np.float64).T * 1e-3
    return Timing(late, work)


def _plots(gathering: _Gathering) -> list[Plot]:
    found: dict[str, list[Series]] = {}
    for channel, place, label in _places(gathering):
        low, high = gathering.binned.low[:, place], gathering.binned.high[:, place]
        found.setdefault(channel.plot, []).append(Series(label, low, high, channel.asked))
    return [Plot(title, series) for title, series in found.items()]


def _places(gathering: _Gathering) -> list[tuple[Channel, int, str]]:
    """Each label of the layout with its channel and its place in a row."""
    labels = iter(enumerate(gathering.layout.labels))
    found = []
    for channel, size in gathering.layout.sizes():
        found += [(channel, *next(labels)) for _ in range(size)]
    return found


def _is_told(series: Series) -> bool:
    return bool(np.isfinite(series.low).any())


def _way(poses: Sequence[tuple[float, float]]) -> Way | None:
    """Of poses that fall on the same place of a grid the first, on the finest grid that leaves few enough."""
    places = np.array(poses or [_NOWHERE], np.float64)
    if not np.isfinite(places).any():
        return None
    extent = float(np.max(np.nanmax(places, axis=0) - np.nanmin(places, axis=0)))
    grid = max(extent, 1e-3) / FINEST
    while len(kept := _thinned(places, grid)) > PATH_POINTS:
        grid *= 1.5
    return Way(kept[:, 0], kept[:, 1], grid * 2.0**0.5)


def _thinned(places: Numbers, grid: float) -> Numbers:
    whole = np.floor(places / grid)
    changed = np.any(whole[1:] != whole[:-1], axis=1)  # NaN is not equal to itself
    keep = np.concatenate([[True], changed])
    keep[-1] = True
    return places[keep]
