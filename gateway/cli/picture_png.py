"""A sheet as a PNG file, without a display."""

from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from gateway.setup.picture import STYLES, Mark, Sheet, Words

_POINT: Final = 72.0  # to an inch; a px of the sheet is one
_DPI: Final = 144.0  # two pixels to a px


def draw(sheet: Sheet, path: Path) -> None:
    """Into this file. Raises OSError."""
    figure = Figure(figsize=(sheet.width / _POINT, sheet.height / _POINT), dpi=_DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, sheet.width), ylim=(sheet.height, 0.0))
    axes.axis("off")
    for place, mark in enumerate(sheet.marks):
        _mark(axes, mark, place)
    for words in sheet.words:
        _words(axes, words, len(sheet.marks))
    figure.savefig(path, format="png")


def _mark(axes: Axes, mark: Mark, place: int) -> None:
    style = STYLES[mark.style]
    drawn = Polygon(
        mark.points,
        closed=mark.closed,
        facecolor=style.fill or "none",
        edgecolor=style.stroke or "none",
        linewidth=style.width,
        zorder=place,
    )
    if style.dash:
        drawn.set_linestyle((0.0, tuple(part / style.width for part in style.dash)))
    axes.add_patch(drawn)


def _words(axes: Axes, words: Words, place: int) -> None:
    axes.text(
        *words.at,
        words.text,
        fontsize=words.size,
        fontweight="bold" if words.strong else "normal",
        ha="center" if words.middle else "left",
        va="baseline",
        zorder=place,
        parse_math=False,
    )
