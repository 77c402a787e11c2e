"""`python -m tests.bench [--json] [NAME ...]`: every figure that an issue names, its peer and its aim, in one run.

NAME: only these parts (cycle, pull, slip, launch, verify, fleet, sessions, live, recorder, damage, plant, laws).
Peers are measured side by side with what they stand beside, so that a busy machine meets both; figures without a peer
want a quiet one. Aims with two numbers are for the compiled core and for pure Python: the first line says which it
is. Aims that are times are for the machine of the issue that named them: a yardstick, measured with every part, tells
how many times slower this one is (`yardstick.py`), and beside such a figure stands what it would be there, which is
what is judged.
"""

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from gateway.build import COMPILED, FORM
from replay.inject.laws import ALL_LAWS
from tests.bench import (
    cycle,
    damage,
    fleet,
    launch,
    laws,
    live,
    plant,
    pull_law,
    recorder,
    sessions,
    slip,
    verify,
    view,
    yardstick,
)
from tests.world import NAMES

PARTS: Mapping[str, tuple[str, Callable[[], dict[str, float]]]] = {
    "cycle": ("one cycle of the core, 4 motors, 8 received frames", cycle.measure),
    "pull": ("pull region and limping, us of each cycle of moby", pull_law.measure),
    "slip": (
        "slip check, us of each cycle of omni4 (`python -m tests.bench.slip` looks for false alarms)",
        slip.measure,
    ),
    "launch": (
        "no-slip launch, us of each cycle of omni4 (`python -m tests.bench.launch` launches in eight directions)",
        launch.measure,
    ),
    "verify": ("replay verify at 1 kHz, in multiples of real time", verify.measure),
    "fleet": (
        f"verdicts on {fleet.SESSIONS} short sessions, in one process, in two, by two workers of a cluster",
        fleet.measure,
    ),
    "sessions": ("sessions beside logs of the same frames, bytes and us per cycle", sessions.measure),
    "live": ("the service at 1 kHz, the simulated robot in a process of its own, us", live.measure),
    "view": ("who looks on: what it costs the service at 1 kHz, us, processor ms/s, kB", view.measure),
    "recorder": ("recorder: the loop's share per cycle, and the disk's", recorder.measure),
    "damage": ("recordings after kills, cuts and flipped bits: seconds lost, and what must not be", damage.measure),
    "plant": ("plant step: one substep of 1 ms of the simulated world, us", plant.measure),
    "laws": ("laws of motion over random drives (`python -m tests.bench.laws` drives more)", laws.measure),
}


class Aim(NamedTuple):
    """`peer`: the figure beside which it stands. `most`, `least`: what is aimed at.

    `work`: 1 for a time that the processor takes, -1 for work per time, 0 for what no processor changes.
    """

    peer: str | None = None
    most: float | None = None
    least: float | None = None
    work: int = 0

    def met(self, value: float) -> bool | None:
        """None: there is no number to meet."""
        if self.most is None and self.least is None:
            return None
        return (self.most is None or value <= self.most) and (self.least is None or value >= self.least)

    def scaled(self, value: float, slowness: float) -> float:
        """What it would be on the machine of the issues."""
        return value / slowness**self.work


def _verify_aims() -> Iterator[tuple[str, Aim]]:
    for name, least in zip(NAMES, (80.0, 60.0), strict=True):
        yield f"verify_realtime_ratio_{name}", Aim(least=least if COMPILED else None, work=-1)
        yield f"verify_gain_two_processes_{name}", Aim(f"counting_gain_two_processes_{name}", least=1.8)


def _session_aims() -> Iterator[tuple[str, Aim]]:
    for name in NAMES:
        for rate, most_bytes, most_us in (("250hz", 300.0, None), ("1000hz", 250.0, 4.0)):
            yield f"session_bytes_{name}_{rate}", Aim(f"mcap_zstd_bytes_{name}_{rate}", most=most_bytes)
            yield f"session_read_us_{name}_{rate}", Aim(f"blf_read_us_{name}_{rate}", most=most_us, work=1)


AIMS: Mapping[str, Aim] = {
    "cycle_us": Aim(work=1),
    "cycle_per_wire_frame": Aim(most=0.10 if COMPILED else 0.35, work=1),
    "pull_added_us": Aim("speed_law_us", most=5.0, work=1),
    "ability_limping_us": Aim("ability_us"),
    "slip_us": Aim(most=4.0, work=1),
    "launch_us": Aim(most=8.0, work=1),
    **dict(_verify_aims()),
    **dict(_session_aims()),
    "fleet_gain_two_processes": Aim("fleet_counting_gain"),
    "fleet_gain_two_workers": Aim("fleet_counting_gain"),
    "plant_step_us_moby_dynamics": Aim(most=300.0, work=1),
    "plant_slippery_step_us_moby_dynamics": Aim(most=300.0, work=1),
    "plant_step_us_omni4_dynamics": Aim(most=300.0, work=1),
    "plant_slippery_step_us_omni4_dynamics": Aim(most=300.0, work=1),
    "plant_step_us_odd_dynamics": Aim(most=300.0, work=1),
    "plant_slippery_step_us_odd_dynamics": Aim(most=300.0, work=1),
    "loop_late_p50_us": Aim("empty_loop_late_p50_us"),
    "loop_late_p99_us": Aim("empty_loop_late_p99_us"),
    "loop_late_p999_us": Aim("empty_loop_late_p999_us"),
    **{
        f"view_{word}_{name}": Aim(f"view_{word}_none")
        for name in ("one", "ten", "frozen", "killed")
        for word in view.Figures._fields
    },
    "view_memory_growth_kb_frozen": Aim("view_memory_growth_kb_none"),
    "view_records_dropped": Aim(most=0.0),
    "put_to_thread_p50_us": Aim("bare_zenoh_thread_p50_us"),
    "put_to_thread_p99_us": Aim("bare_zenoh_thread_p99_us"),
    "put_to_can_p50_us": Aim("bare_zenoh_and_half_period_us"),
    **{
        f"{way}_loss_max_s": Aim(most=0.5)
        for way in ("recorder_killed", "service_killed", "both_killed", "cut", "flip")
    },
    "flips_unnoticed": Aim(most=0.0),
    "flips_altered": Aim(most=0.0),
    **{f"violations_{law.replace(' ', '_')}": Aim(most=0.0) for law in ALL_LAWS},
}


def _line(name: str, figures: Mapping[str, float], slowness: float) -> str:
    aim, value = AIMS.get(name, Aim()), figures[name]
    there = f"{aim.scaled(value, slowness):10.4g}" if aim.work else f"{'':10}"
    peer = "" if aim.peer is None else f"{figures[aim.peer]:10.4g} {aim.peer}"
    bound = f"<= {aim.most:g}" if aim.most is not None else f">= {aim.least:g}" if aim.least is not None else ""
    verdict = {None: "", True: "met", False: "MISSED"}[aim.met(aim.scaled(value, slowness))]
    return f"  {name:44} {value:10.4g} {there}  {bound:8} {verdict:6}  {peer}".rstrip()


def main() -> None:
    as_json = "--json" in sys.argv
    wanted = [argument for argument in sys.argv[1:] if argument in PARTS] or list(PARTS)
    figures: dict[str, float] = {}
    told: dict[str, dict[str, object]] = {}
    if not as_json:
        print(f"{FORM}; figure, the same on the machine of the issues, aim, peer")
    for title, measure in map(PARTS.__getitem__, wanted):
        before = yardstick.now()
        found = measure()
        slowness = yardstick.slowness([*before, *yardstick.now()])
        figures |= found
        if not as_json:
            print(f"{title} ({slowness:.2f} times slower here)")
            print(*(_line(name, figures, slowness) for name in found), sep="\n", flush=True)
        told |= {name: _told(name, value, slowness) for name, value in found.items()}
    if as_json:
        print(json.dumps({"core": FORM, "figures": told}))


def _told(name: str, value: float, slowness: float) -> dict[str, object]:
    aim = AIMS.get(name, Aim())
    there = aim.scaled(value, slowness)
    bounds = {"peer": aim.peer, "most": aim.most, "least": aim.least}
    return {
        "value": value,
        "slowness": slowness,
        "scaled": there if aim.work else None,
        **bounds,
        "met": aim.met(there),
    }


if __name__ == "__main__":
    main()
