"""Every experiment by name, and running one: its folder, picture and table."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from replay.reproduce import (
    arcs,
    drawing,
    hits,
    impact,
    kane,
    kane_paths,
    kane_tracking,
    odd,
    rojas,
    rojas_launch,
    straight,
    tables,
    torques,
)
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
    "rojas-fig4": Experiment("Figure 4: effective motors", rojas.figure_4, 3),
    "rojas-fig9": Experiment("Figure 9: what of the speed the rollers provide", rojas.figure_9, 5),
    "rojas-fig10": Experiment("Figure 10: constant torque by voltage steps", rojas_launch.figure_10, 2),
    "rojas-launch": Experiment("Sections 7 and 8: launched without slip", rojas_launch.launches, 11),
    "rojas-slip": Experiment("Section 9: wheels that slip", rojas.slip_table, 1),
    "rojas-dead": Experiment("Section 11: without one motor", rojas.dead_motors, 4),
    "kane-fig7": Experiment("Figure 7: along a diagonal while spinning", kane.figure_7, 2),
    "kane-fig8": Experiment("Figure 8: wheel speeds that no motion explains", kane.figure_8, 1),
    "kane-fig9": Experiment("Figures 9 to 12: torques, energy and momentum", kane.figure_9, 3),
    "kane-fig13": Experiment("Figures 13 to 18: along a figure eight", kane_tracking.figure_13, 2),
    "kane-fig19": Experiment("Figures 15 and 19 to 22: sharp corners", kane_tracking.figure_19, 3),
    "kane-fig24": Experiment("Figures 23 to 27: pushed on the figure eight", kane_tracking.figure_24, 2),
    "kane-tracking": Experiment("Along paths: wheel control and the service's loop", kane_paths.tracking, 6),
    "odd-fig8": Experiment("Figure 8: four paths", odd.figure_8, 4),
    "odd-fig9": Experiment("Figure 9: four paths on ball casters", odd.figure_9, 6),
    "odd-fig10": Experiment("Figure 10: the width changed in motion", odd.figure_10, 3 * len(odd.FORMS)),
    "odd-fig11": Experiment("Figure 11: narrow passages", odd.figure_11, len(odd.FORMS)),
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
