"""The picture of a tuned speed loop: the fit, and what both loops make of a step."""

from pathlib import Path

from replay.identify.gains import stepped
from replay.identify.response import Response
from replay.identify.tuning import Tuned
from replay.reproduce.drawing import draw
from replay.reproduce.picture import Line, Panel, Picture

SECONDS = 0.5


def draw_tuned(motor: str, tuned: Tuned, path: Path) -> None:
    """Two rows: what was measured and told; the steps that the model foresees with both loads. Raises OSError."""
    t = tuned.times
    speed = (
        Line("measured", t, tuned.speeds),
        Line("model", t, tuned.answer.modelled.tolist(), 1, dashed=True),
    )
    fit = (
        Panel("speed", "t [s]", "rad/s", speed),
        Panel("torque told", "t [s]", "N m", (Line("", t, tuned.torques, 2),)),
    )
    steps = (
        _steps("foreseen, as it was turned", tuned, tuned.answer.response),
        _steps("foreseen, with the robot", tuned, tuned.loaded()),
    )
    draw(Picture(f"{motor}: kp {tuned.after.kp:g}, ki {tuned.after.ki:g}", [fit, steps]), path)


def _steps(title: str, tuned: Tuned, response: Response) -> Panel:
    lines = []
    for number, (name, loop) in enumerate((("before", tuned.before), ("after", tuned.after))):
        times, speeds = stepped(response, loop, period=tuned.period, seconds=SECONDS)
        lines.append(Line(name, times.tolist(), speeds.tolist(), number, dashed=number == 0))
    return Panel(title, "t [s]", "rad/s", tuple(lines), y_range=(0.0, 2.0))
