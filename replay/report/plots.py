"""The channels and the path of a robot over a whole session, computed again by its core from the recorded inputs.

As in `replay.compare.retrace`; they are unknown where no recorded state of the core leads.
"""

from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

import numpy as np

from gateway.config import RobotConfig
from gateway.core.channels import AXIS, MOTOR, Channel, Layout, channels_of, owners
from gateway.types import Inputs, Mode, Trace
from replay.compare.replay import CRASHES, Replay
from replay.report.binned import Binned, Numbers, stretches_of
from replay.report.track import Station, Track
from replay.sessions.reader import Session

TURNING = ("wz", "theta")  # what is an angle where a channel has two units


class Series(NamedTuple):
    """A channel over time: least and greatest of each stretch, NaN where it is unknown."""

    label: str
    low: Numbers
    high: Numbers
    asked: bool

    @property
    def told(self) -> bool:
        """Whether it is known anywhere."""
        return bool(np.isfinite(self.low).any())


class Panel(NamedTuple):
    """What shares an axis. `owner`: axis or motor that it is of, "" where owners are drawn together."""

    owner: str
    unit: str
    series: Sequence[Series]


class Plot(NamedTuple):
    """Channels that are looked at together."""

    title: str
    panels: Sequence[Panel]


class Channels:
    """Takes the inputs of cycle after cycle. Raises ConfigError at construction."""

    def __init__(self, config: RobotConfig, session: Session, seconds: float, cycles: int) -> None:
        shown = [channel for channel in channels_of(config) if channel.plot]
        self.drawing = config.robot.drawing()
        self.replay = Replay(config, session.snapshot)
        self.track = Track()
        self.top_speed: float | None = None  # m/s, measured
        self._owners = owners(config)
        self._layout = Layout(self._owners, shown)
        self.stretches = stretches_of(seconds, cycles, len(self._layout.labels))
        self._binned = Binned(self.stretches, len(self._layout.labels))
        self._joint = 0.0

    def add(self, t: float, inputs: Inputs, mode: Mode) -> None:
        """The next cycle, t in s, and the mode that was recorded."""
        engine = self.replay.engine(inputs)
        if engine is None:
            self.track.part()
            return
        try:
            trace = engine.step(inputs).trace
        except CRASHES:  # the verdict says so
            self.replay.lose()
            self.track.part()
            return
        self._binned.add(t, self._layout.row(trace))
        self._move(trace, mode)

    def _move(self, trace: Trace, mode: Mode) -> None:
        if self.drawing.beneath is not None:
            angle = trace.wheel_positions[self.drawing.beneath]
            self._joint = self._joint if angle is None else angle
        self.track.add(Station(*trace.pose, self._joint, mode.value))
        if trace.measured is not None:
            self.top_speed = max(self.top_speed or 0.0, hypot(trace.measured.vx, trace.measured.vy))

    def finish(self) -> list[Plot]:
        """All of them. Where something is asked for, each axis or motor has a panel; else what has the same unit."""
        self._binned.finish()
        self.track.part()
        found: dict[str, dict[tuple[str, str], list[Series]]] = {}
        compared = {channel.plot for channel, _ in self._layout.sizes() if channel.asked}
        for place, (channel, owner, name) in enumerate(self._named()):
            apart = owner if channel.plot in compared else ""
            label = name.strip("._") if apart else self._layout.labels[place]
            panels = found.setdefault(channel.plot.partition(" [")[0], {})
            series = panels.setdefault((apart, _unit(channel, owner or name)), [])
            series.append(Series(label, self._binned.low[:, place], self._binned.high[:, place], channel.asked))
        return [Plot(title, [Panel(*key, series) for key, series in panels.items()]) for title, panels in found.items()]

    def _named(self) -> list[tuple[Channel, str, str]]:
        """Of each label: its channel, axis or motor ("" of none), and name."""
        found = []
        for channel, _ in self._layout.sizes():
            apart = channel.owner in {AXIS, MOTOR}
            having = self._owners[channel.owner] if apart else [""]
            names = channel.names if apart else channel.labels(self._owners)
            found += [(channel, owner, name) for owner in having for name in names]
        return found


def _unit(channel: Channel, name: str) -> str:
    """Of the one that has this name; lengths come first where there are two."""
    units = channel.unit.split(", ")
    return units[-1] if name in TURNING else units[0]
