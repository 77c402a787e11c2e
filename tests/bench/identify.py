"""How often intervals hold the truth, what MuJoCo's robots come out as, and what-ifs against what then really happens.

python -m tests.bench.identify [SEEDS]
"""

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import msgspec

from gateway.config import parse
from replay.compare.likeness import Comparison, Moment, compare
from replay.identify.closed import ClosedLoopWhatIf
from replay.identify.identify import Identified, identify
from replay.identify.parameters import TORQUE_SCALE, Refused, values_of
from replay.sessions.reader import open_session
from replay.sim.plants.contract import PlantName
from tests.replay.identified_drives import (
    MASS,
    SLACK,
    STIFF,
    Driven,
    drive,
    heavy_omni,
    pulled_twists,
    random_twists,
    text_of,
)
from tests.replay.mujoco_plant import MUJOCO_PLANTS

NOISE = 0.003  # rad/s at the output, of every encoder
SEEDS = 24
COVERED = (("moby", PlantName.SIMPLE), ("moby", PlantName.DYNAMICS), ("omni4", PlantName.SIMPLE))
KINDS = {"moby": "offset_differential", "omni4": "omni"}
SECONDS = {"moby": 15.0, "omni4": 10.0}


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS
    with tempfile.TemporaryDirectory() as folder:
        for name, plant in COVERED:
            coverage(Path(folder), name, plant, seeds)
        for name, setting in (("moby", {"compensation_gain": 1.2}), ("omni4", {"speed_override": 0.5})):
            predicted(Path(folder), name, setting)
        heavier(Path(folder))


def coverage(folder: Path, name: str, plant: PlantName, seeds: int) -> None:
    """Of each parameter: how many of its intervals hold the truth, and how wide they are."""
    held: dict[str, list[bool]] = {}
    widths: dict[str, list[float]] = {}
    for seed in range(seeds):
        driven = drive(
            folder / f"{name}-{plant.value}-{seed}",
            text_of(name, gentle=False),
            random_twists(seed),
            seconds=SECONDS[name],
            plant=plant,
            noise=NOISE,
            seed=seed,
        )
        true = values_of(driven.config.robot)
        for parameter, one in identify(open_session(driven.path)).file.found.items():
            held.setdefault(parameter, []).append(one.low <= true[parameter] <= one.high)
            widths.setdefault(parameter, []).append((one.high - one.low) / 2.0 / true[parameter])
    for parameter, all_of in held.items():
        half = 100.0 * sum(widths[parameter]) / len(all_of)
        print(f"{name} {plant.value} {parameter}: {sum(all_of)} of {len(all_of)}, +-{half:.2f} %", flush=True)
    every = [one for all_of in held.values() for one in all_of]
    print(f"{name} {plant.value}: {sum(every)} of {len(every)} = {100.0 * sum(every) / len(every):.1f} %", flush=True)


def predicted(folder: Path, name: str, setting: Mapping[str, float]) -> None:
    """A drive on MuJoCo's plant: identified, asked what if, and driven so."""
    text, plant = text_of(name), MUJOCO_PLANTS[KINDS[name]]
    twists = pulled_twists(3) if name == "moby" else random_twists(0)
    then = drive(folder / f"{name}-then", text, twists, seconds=16.0, plant=plant)
    truly = drive(folder / f"{name}-truly", text, twists, seconds=16.0, plant=plant, settings=dict(setting))
    found = identify(open_session(then.path))
    tell(name, found, values_of(then.config.robot))
    question = ClosedLoopWhatIf(open_session(then.path), found.file, setting)
    for _ in question.steps():
        pass
    effect = compare(moments(then), moments(truly), then.config, name)
    rows = (
        ("recorded settings against the recording", question.reproduced),
        ("predicted change", question.effect),
        ("true change", effect),
    )
    for words, one in rows:
        print(f"{name} {setting}: {words}: {in_words(one)}", flush=True)


def heavier(folder: Path) -> None:
    """A robot heavier than its file says, with a slack speed loop: by what was identified, and by the file."""
    text, twists = text_of("omni4"), random_twists(4)
    slack = text.replace(STIFF, SLACK)
    then = drive(folder / "heavy-then", text, twists, seconds=6.0, plant=heavy_omni)
    truly = drive(folder / "heavy-truly", slack, twists, seconds=6.0, plant=heavy_omni)
    found = identify(open_session(then.path))
    tell(f"omni4 of {MASS:g} kg", found, values_of(then.config.robot))
    file = values_of(then.config.robot)
    of_file = {name: Refused(value, "robot file") for name, value in file.items()}
    by_file = msgspec.structs.replace(found.file, found={}, not_found=of_file)
    for words, known in (("identified", found.file), ("in its file", by_file)):
        question = ClosedLoopWhatIf(open_session(then.path), known, {}, parse(slack, "slack"))
        for _ in question.steps():
            pass
        print(f"slack, by what is {words}: {in_words(question.effect)}", flush=True)
    print(f"slack, truly: {in_words(compare(moments(then), moments(truly), then.config, 'heavy'))}", flush=True)


def tell(name: str, found: Identified, file: Mapping[str, float]) -> None:
    """What was found, beside what MuJoCo's robot was made of."""
    print(f"{name} on MuJoCo, fitted by plant {found.file.plant}:")
    for parameter, one in found.file.found.items():
        print(f"  {parameter}: {one.value:.4g} ({one.low:.4g} to {one.high:.4g}), robot file {file[parameter]:.4g}")
    for parameter, refused in found.file.not_found.items():
        if parameter != TORQUE_SCALE:
            print(f"  {parameter}: {refused.reason}")
    print(f"  left over {found.file.residuals} of {found.file.torques} N m")


def moments(driven: Driven) -> list[Moment]:
    """As the core said where it was."""
    return [
        Moment(inputs.now_ns, outputs.trace.pose, outputs.trace.wheel_speeds, outputs.mode)
        for inputs, outputs in driven.cycles
    ]


def in_words(one: Comparison) -> str:
    return (
        f"end {one.end_m:.4f} m {one.end_rad:.4f} rad, path {one.largest_m:.4f} m of {one.path_m:.2f}, "
        f"wheels {100.0 * one.wheels_rms:.2f} %"
    )


if __name__ == "__main__":
    main()
