"""Every experiment by name, and running one: its folder, picture and table."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from replay.reproduce import arcs, drawing, hits, impact, straight, tables, torques
from replay.reproduce.result import Found, Result, Stage


class Experiment(NamedTuple):
    """`parts`: how often it tells what it is doing."""

    title: str
    run: Callable[[Stage], Found]
    parts: int


EXPERIMENTS: dict[str, Experiment] = {
    "moby-fig5": Experiment("Figure 5: the chassis reverses by itself", straight.figure_5, 3),
    "moby-fig7": Experiment("Figure 7: the velocity is mirrored, and the chassis comes back", straight.figure_7, 2),
    "moby-fig8": Experiment("Figure 8: a blow at the fork of the caster", impact.figure_8, 4),
    "moby-fig9": Experiment("Figures 9 and 10: along arcs, pulled", arcs.figure_9, 3),
    "moby-fig11": Experiment("Figures 11 and 12: torques and forces of the flip", torques.figure_11, 6),
    "moby-fig13": Experiment("Figure 13: the caster while the robot accelerates", torques.figure_13, 5),
    "moby-fig14": Experiment("Figure 14: the caster comes out of its unstable position", torques.figure_14, 5),
    "moby-fig15": Experiment("Figure 15: both experiments of section 8", hits.figure_15, 4),
}


def reproduce(name: str, out: Path, *, started_wall_ns: int, tell: Callable[[str], None]) -> Result:
    """Run it, and write everything of it into a folder of its name. Raises OSError, ReproduceError."""
    experiment, folder = EXPERIMENTS[name], out / name
    folder.mkdir(parents=True, exist_ok=True)
    found = experiment.run(Stage(folder, started_wall_ns, tell))
    picture, table = folder / f"{name}.png", folder / f"{name}.md"
    drawing.draw(found.picture, picture)
    result = Result(name, experiment.title, found.rows, found.notes, found.sessions, picture, table)
    table.write_text(tables.markdown(result), encoding="utf-8")
    return result
