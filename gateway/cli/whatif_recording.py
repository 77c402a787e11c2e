"""A drive as recorded and as it would have been, side by side in one Rerun recording."""

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, Self

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from gateway.config import RobotConfig
from gateway.core.channels import Layout, channels_of, entities, owners, plots
from gateway.recording.schema import APPLICATION_ID, CYCLE

TIME = "time"  # s since the first recorded cycle
PERIOD_S = 0.02  # of what is drawn, as in a session
BATCH = 500  # points sent at once: memory stays flat
FLUSH_TIMEOUT_S = 10.0
# One number has the same colour on every side; the viewer would give each line one of its own.
COLOURS = (0x4C9BE8, 0xF28E2B, 0x59A14F, 0xE15759, 0xB07AA1, 0x76B7B2, 0xEDC948, 0xFF9DA7, 0x9C755F, 0xA0A0A0)
_LEGEND = rrb.PlotLegend(rrb.Corner2D.RightTop)


class Drawn(Protocol):
    """A step: `t`, s since the first recorded cycle, and `cycle`; beside them the outputs of each side."""

    @property
    def t(self) -> float: ...
    @property
    def cycle(self) -> int: ...


class Recording:
    """Give it every step; use it as a context, which leaves no file behind where an error ends it.

    `sides`: robots by the fields of a step that have their outputs.

    Raises OSError at construction.
    """

    def __init__(self, path: Path, name: str, sides: Mapping[str, RobotConfig]) -> None:
        self._layouts = {side: _layouts(robot) for side, robot in sides.items()}
        self._steps: list[Drawn] = []
        self._next_t = 0.0
        self._recording = rr.RecordingStream(APPLICATION_ID, recording_id=f"whatif-{name}", send_properties=False)
        try:
            self._recording.save(path, default_blueprint=_blueprint(sides))
        except RuntimeError as error:
            raise OSError(None, str(error)) from None
        self._path = path
        colours: dict[tuple[str, str], int] = {}
        for side, layouts in self._layouts.items():
            for entity, layout in layouts.items():
                keys = [(entity, label) for label in layout.labels]
                for key in keys:
                    colours.setdefault(key, COLOURS[len(colours) % len(COLOURS)] << 8 | 0xFF)
                names = [f"{label} {side}" for label in layout.labels]
                lines = rr.SeriesLines(names=names, colors=np.array([colours[key] for key in keys], np.uint32))
                self._recording.log(f"{side}/{entity}", lines, static=True)

    def add(self, step: Drawn) -> None:
        """Draw a step, if one is due."""
        if step.t >= self._next_t:
            self._next_t = step.t + PERIOD_S
            self._steps.append(step)
            if len(self._steps) >= BATCH:
                self._send()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None and self._steps:
            self._send()
        self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        self._recording.disconnect()
        if kind is not None:
            self._path.unlink(missing_ok=True)

    def _send(self) -> None:
        steps, self._steps = self._steps, []
        when = [
            rr.TimeColumn(CYCLE, sequence=[step.cycle for step in steps]),
            rr.TimeColumn(TIME, duration=[step.t for step in steps]),
        ]
        for side, layouts in self._layouts.items():
            traces = [getattr(step, side).trace for step in steps]
            for entity, layout in layouts.items():
                numbers = np.array([layout.row(trace) for trace in traces], np.float64)  # None: a hole in the line
                self._recording.send_columns(f"{side}/{entity}", when, rr.Scalars.columns(scalars=numbers))


def _layouts(config: RobotConfig) -> dict[str, Layout]:
    """Entities of channels that have a number at all."""
    having = owners(config)
    found = {entity: Layout(having, group) for entity, group in entities(channels_of(config)).items()}
    return {entity: layout for entity, layout in found.items() if layout.labels}


def _blueprint(sides: Mapping[str, RobotConfig]) -> rrb.Blueprint:
    """Every plot of the recorded session, one beside the other; the first of them has a place of its own."""
    recorded = next(iter(sides.values()))
    wheels, *others = (
        rrb.Horizontal(*(_plot(side, name, shown) for side in sides), name=name)
        for name, shown in plots(channels_of(recorded)).items()
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
