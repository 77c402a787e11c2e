"""Writes the figures of the documentation: `python -m tests.chassis_figures`, a bundled robot of each chassis."""

from pathlib import Path
from typing import Final

from gateway import robot_files
from gateway.cli.picture import svg
from gateway.config import load
from gateway.setup.picture import from_above

FOLDER: Final = Path(__file__).parent.parent / "deploy" / "images"
SHOWN: Final = {"offset_differential": "moby", "omni": "omni4", "mecanum": "mecanum4", "odd": "odd"}


def place(kind: str) -> Path:
    """Where the figure of this chassis is."""
    return FOLDER / f"chassis-{kind}.svg"


def figure(kind: str) -> str:
    """As it has to be."""
    return svg(from_above(load(robot_files.bundled()[SHOWN[kind]])[0].robot))


if __name__ == "__main__":
    for shown in SHOWN:
        place(shown).write_text(figure(shown), encoding="utf-8")
