"""The layout with which the viewer opens a session."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from gateway.config import RobotConfig
from gateway.core.channels import channels_of, plots
from gateway.recording.schema import CYCLE, WALL
from gateway.recording.shapes import BODY, PATH, WORLD
from gateway.recording.views import (
    CAN_IN,
    CAN_OUT,
    CHANNELS_ROOT,
    CONFIG,
    EVENTS,
    LOOP,
    MODE,
)

PATH_SECONDS = 120.0
EYE_HEIGHTS = 10.0  # of the eye above the robot, in radii of its body
_LEGEND = rrb.PlotLegend(rrb.Corner2D.RightTop)
_EVENT_COLUMNS = rrb.TextLogColumns(timeline_columns=[CYCLE], text_log_columns=["loglevel", "body"])
_CAN_COLUMNS = rrb.TextLogColumns(timeline_columns=[CYCLE], text_log_columns=["body"])


def blueprint(config: RobotConfig, *, follow: bool = False) -> rrb.Blueprint:
    """Robot from above, its path | wheel speeds, body velocity, loop timing; modes and events along the bottom.

    The first plot of the channels has a place of its own, the others share one, the second of them on top.
    `follow`: of a drive that goes on, whose newest cycle is shown.
    """
    wheels, *others = (_plot(name, shown) for name, shown in plots(channels_of(config)).items())
    eye_height = EYE_HEIGHTS * config.robot.drawing().reach
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Vertical(_from_above(eye_height), _whole_path(), row_shares=[3, 2]),
                rrb.Vertical(
                    wheels,
                    rrb.Tabs(*others, active_tab=0),
                    rrb.TimeSeriesView(origin=LOOP, name="Loop timing [ms]", plot_legend=_LEGEND),
                    row_shares=[3, 3, 2],
                ),
                column_shares=[2, 3],
            ),
            rrb.Horizontal(
                rrb.StateTimelineView(origin=MODE, name="Mode"),
                rrb.Tabs(
                    rrb.TextLogView(origin=EVENTS, name="Events", columns=_EVENT_COLUMNS),
                    rrb.TextLogView(origin=CAN_IN, name="CAN in", columns=_CAN_COLUMNS),
                    rrb.TextLogView(origin=CAN_OUT, name="CAN out", columns=_CAN_COLUMNS),
                    rrb.TextDocumentView(origin=CONFIG, name="Robot file"),
                    active_tab=0,
                ),
                column_shares=[3, 2],
            ),
            row_shares=[4, 1],
        ),
        rrb.TimePanel(state="collapsed", timeline=WALL, play_state="Following" if follow else None),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _plot(name: str, shown: Sequence[str]) -> rrb.TimeSeriesView:
    paths = [f"{CHANNELS_ROOT}/{entity}" for entity in shown]
    return rrb.TimeSeriesView(origin=CHANNELS_ROOT, contents=paths, name=name, plot_legend=_LEGEND)


def _from_above(eye_height: float) -> rrb.Spatial3DView:
    """Forward is up and left is left, as in the robot's own axes at the start; the eye goes with the robot.

    The viewer follows only what has something to draw, hence the body and not the frame it belongs to.
    """
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=(0.0, 0.0, eye_height),
        look_target=(0.0, 0.0, 0.0),
        eye_up=(1.0, 0.0, 0.0),
        tracking_entity=BODY,
    )
    return _scene(
        "From above; velocity wanted (orange) and measured (blue)",
        path_from=rrb.TimeRangeBoundary.cursor_relative(seconds=-PATH_SECONDS),
        eye_controls=eye,
    )


def _whole_path() -> rrb.Spatial3DView:
    """All of it up to now; without an eye of its own the viewer takes one that sees everything."""
    return _scene("Whole path", path_from=rrb.TimeRangeBoundary.infinite())


def _scene(
    name: str, *, path_from: rrb.TimeRangeBoundary, eye_controls: rrb.EyeControls3D | None = None
) -> rrb.Spatial3DView:
    trail = rrb.VisibleTimeRanges(timeline=WALL, start=path_from, end=rrb.TimeRangeBoundary.cursor_relative())
    return rrb.Spatial3DView(
        origin=WORLD,
        name=name,
        overrides={PATH: trail},
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, color=0x80808050),
        eye_controls=eye_controls,
    )
