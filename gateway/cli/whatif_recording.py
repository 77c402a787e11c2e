"""A drive as recorded and as it would have been commanded, side by side in one Rerun recording."""

from pathlib import Path
from typing import Self

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from gateway.config import RobotConfig
from gateway.core.channels import Layout, channels_of, entities, owners, plots
from gateway.recording.schema import APPLICATION_ID, CYCLE
from replay.compare.what_if import Step

SIDES = ("recorded", "new")
TIME = "time"  # s since the first recorded cycle
PERIOD_S = 0.02  # of what is drawn, as in a session
BATCH = 500  # points sent at once: memory stays flat
FLUSH_TIMEOUT_S = 10.0
_LEGEND = rrb.PlotLegend(rrb.Corner2D.RightTop)


class Recording:
    """Give it every step; use it as a context. Raises OSError at construction."""

    def __init__(self, path: Path, name: str, config: RobotConfig, new: RobotConfig) -> None:
        self._layouts = tuple(_layouts(robot) for robot in (config, new))
        self._steps: list[Step] = []
        self._next_t = 0.0
        self._recording = rr.RecordingStream(APPLICATION_ID, recording_id=f"whatif-{name}", send_properties=False)
        try:
            self._recording.save(path, default_blueprint=_blueprint(config))
        except RuntimeError as error:
            raise OSError(None, str(error)) from None
        for side, layouts in zip(SIDES, self._layouts, strict=True):
            for entity, layout in layouts.items():
                lines = rr.SeriesLines(names=[f"{label} {side}" for label in layout.labels])
                self._recording.log(f"{side}/{entity}", lines, static=True)

    def add(self, step: Step) -> None:
        """Draw a step, if one is due."""
        if step.t >= self._next_t:
            self._next_t = step.t + PERIOD_S
            self._steps.append(step)
            if len(self._steps) >= BATCH:
                self._send()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._steps:
            self._send()
        self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        self._recording.disconnect()

    def _send(self) -> None:
        steps, self._steps = self._steps, []
        when = [
            rr.TimeColumn(CYCLE, sequence=[step.cycle for step in steps]),
            rr.TimeColumn(TIME, duration=[step.t for step in steps]),
        ]
        for side, layouts in zip(SIDES, self._layouts, strict=True):
            traces = [getattr(step, side).trace for step in steps]
            for entity, layout in layouts.items():
                numbers = np.array([layout.row(trace) for trace in traces], np.float64)  # None: a hole in the line
                self._recording.send_columns(f"{side}/{entity}", when, rr.Scalars.columns(scalars=numbers))


def _layouts(config: RobotConfig) -> dict[str, Layout]:
    """Entities of channels that have a number at all."""
    having = owners(config)
    found = {entity: Layout(having, group) for entity, group in entities(channels_of(config)).items()}
    return {entity: layout for entity, layout in found.items() if layout.labels}


def _blueprint(config: RobotConfig) -> rrb.Blueprint:
    """Every plot of a session, as recorded beside as it would have been; the first of them has a place of its own."""
    wheels, *others = (
        rrb.Horizontal(*(_plot(side, name, shown) for side in SIDES), name=name)
        for name, shown in plots(channels_of(config)).items()
    )
    return rrb.Blueprint(
        rrb.Vertical(wheels, rrb.Tabs(*others, active_tab=0)),
        rrb.TimePanel(state="collapsed", timeline=TIME),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _plot(side: str, name: str, shown: list[str]) -> rrb.TimeSeriesView:
    contents = [f"/{side}/{entity}" for entity in shown]
    return rrb.TimeSeriesView(origin="/", contents=contents, name=f"{name}, {side}", plot_legend=_LEGEND)
