"""The regression corpus: a short recorded drive of every robot, together in every mode, that must stay what it is.

`python -m tests.corpus`: would the core do the same again? Exit 1 where it would not, with a report of its behaviour.
`python -m tests.corpus bless [--report FILE]`: drive those again that changed and keep the new sessions; the report
(markdown) says, signal by signal, what was and what is now: it belongs into the message of the commit that changes it.
"""

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from gateway.config import RobotConfig, load
from gateway.core.frame_words import FrameWords
from gateway.robot_files import find
from gateway.types import Inputs
from replay.compare.replay import CRASHES, Replay
from replay.compare.verify import Verdict, verify
from replay.drive.recording import SessionRecording
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario
from replay.sessions.cycles import RecordedOutputs
from replay.sessions.reader import Session, open_session

FOLDER = Path(__file__).parent / "sessions" / "corpus"
STARTED_WALL_NS = 1_760_000_000_000_000_000  # of every drive, so that none depends on the day
ROBOTS = ("moby", "omni4", "omni4_gm6020", "omni4_vesc", "mecanum4", "odd", "odd_balancing")
SECONDS = 5.2
BARS = " .:-=+*#@"
WIDTH = 40  # of a waveform
MOST_SIGNALS = 40  # of a robot in the report

Numbers = dict[str, float]


class Signal(NamedTuple):
    """One value over time, as recorded and as it is now; of cycles where it is there."""

    name: str
    cycles: int  # that differ
    before: list[float]
    after: list[float]


def scenario(name: str, config: RobotConfig) -> Scenario:
    """Start, drive, fall silent, drive on without a motor for half a second, an emergency stop and its release."""
    velocity = config.limits.velocity
    move = {"vx": 0.3 * velocity.vx, "vy": 0.1 * velocity.vy, "wz": 0.2 * velocity.wz}
    still = {"vx": 0.0, "vy": 0.0, "wz": 0.0}
    upright = [{"t": t, "request": "stand_up"} for t in (0.3, 2.4)] if getattr(config.robot, "balance", None) else []
    at = [
        *upright,
        {"t": 0.3, "command": {"source": "teleop", **still}},
        {"t": 0.8, "command": {"source": "teleop", **move}},
        {"t": 1.2, "silence": "teleop"},
        {"t": 2.4, "command": {"source": "teleop", **still}},
        {"t": 2.7, "command": {"source": "teleop", **move}},
        {"t": 3.0, "fault": {"kind": "power_off", "motor": config.robot.motor_names()[0], "seconds": 0.3}},
        {"t": 3.6, "silence": "teleop"},
        {"t": 4.2, "request": "estop"},
        {"t": 4.8, "request": "reset"},
    ]
    return Scenario.model_validate({"robot": name, "seconds": SECONDS, "at": sorted(at, key=lambda one: one["t"])})


def record(name: str, folder: Path) -> Path:
    """Drive it, and keep the session in this folder."""
    path = find(name)
    config, text = load(path)
    with tempfile.TemporaryDirectory() as directory:
        recording = SessionRecording(
            config, text, path.name, directory=Path(directory), started_wall_ns=STARTED_WALL_NS
        )
        run_scenario(scenario(name, config), config, recording=recording)
        recording.close()
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(recording.session, folder)
    return folder


def check(name: str) -> Verdict:
    """Of the kept session of this robot."""
    return verify(open_session(FOLDER / name))


def signals(session: Session) -> list[Signal]:
    """Every value that a core with the recorded inputs says otherwise now, those that differ longest first."""
    config, _ = load(find(session.header.robot))
    words, replay = FrameWords(config), Replay(config, session.snapshot)
    pairs: dict[str, list[tuple[float, float]]] = {}
    different: dict[str, int] = {}
    for inputs, recorded in session.cycles():
        engine = replay.engine(inputs)
        if engine is None:
            continue
        try:
            fresh = RecordedOutputs.of(engine.step(inputs))
        except CRASHES as error:
            return [Signal(f"the core breaks: {error!r}", 1, [], [])]
        before, after = numbers(words, inputs, recorded), numbers(words, inputs, fresh)
        for key in before.keys() | after.keys():
            one, other = before.get(key, 0.0), after.get(key, 0.0)
            pairs.setdefault(key, []).append((one, other))
            different[key] = different.get(key, 0) + (one != other)
    found = [
        Signal(key, count, [one for one, _ in pairs[key]], [other for _, other in pairs[key]])
        for key, count in different.items()
        if count
    ]
    return sorted(found, key=lambda signal: (-signal.cycles, signal.name))


def numbers(words: FrameWords, _: Inputs, outputs: RecordedOutputs) -> Numbers:
    """What the core said in a cycle, as numbers by name."""
    found: Numbers = {f"mode {outputs.mode.value}": 1.0}
    for event in outputs.events:
        found[f"event {event.code}"] = 1.0
    if outputs.odometry is not None:
        found |= {f"odometry {key}": value for key, value in outputs.odometry._asdict().items() if _is_number(value)}
    for frame in outputs.frames:
        decoded = words.decode(frame)
        if decoded is None:
            continue
        owners = decoded.owners or (decoded.motor,) * len(decoded.fields)
        for motor, (field, value) in zip(owners, decoded.fields, strict=True):
            if _is_number(value):
                found[f"{motor} {decoded.message}.{field}"] = float(value)
    return found


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def waveform(values: Sequence[float], low: float, high: float) -> str:
    """Its course in a few letters, the mean of each stretch."""
    if not values or high <= low:
        return "-" * min(WIDTH, len(values))
    size = max(1, -(-len(values) // WIDTH))
    stretches = [values[place : place + size] for place in range(0, len(values), size)]
    heights = [(sum(one) / len(one) - low) / (high - low) for one in stretches]
    return "".join(BARS[min(len(BARS) - 1, int(height * len(BARS)))] for height in heights)


def report(name: str, found: Sequence[Signal]) -> Iterator[str]:
    """Lines of markdown."""
    yield f"### {name}"
    if not found:
        yield "unchanged"
        return
    yield ""
    yield "| signal | cycles | from | to | was | is |"
    yield "|---|---|---|---|---|---|"
    for signal in found[:MOST_SIGNALS]:
        every = [*signal.before, *signal.after] or [0.0]
        low, high = min(every), max(every)
        ends = [f"{min(one):.4g} to {max(one):.4g}" if one else "" for one in (signal.before, signal.after)]
        waves = [f"`{waveform(one, low, high)}`" for one in (signal.before, signal.after)]
        yield f"| {signal.name} | {signal.cycles} | {ends[0]} | {ends[1]} | {waves[0]} | {waves[1]} |"
    if len(found) > MOST_SIGNALS:
        yield f"and {len(found) - MOST_SIGNALS} more"


def main() -> int:
    """Prints the report; 1 when something changed and is not blessed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=["check", "bless"], default="check")
    parser.add_argument("--report", type=Path, help="also write it into this file")
    wanted = parser.parse_args()
    lines, changed = [], []
    for name in ROBOTS:
        there = (FOLDER / name).is_dir()
        if there and check(name).identical:
            lines.append(f"### {name}\nunchanged")
            continue
        changed.append(name)
        lines += list(report(name, signals(open_session(FOLDER / name)))) if there else [f"### {name}\nnew"]
    text = "\n".join(lines)
    print(text)
    if wanted.report is not None:
        wanted.report.write_text(text + "\n", encoding="utf-8")
    if wanted.what == "check":
        return 1 if changed else 0
    for name in changed:
        print(f"kept {record(name, FOLDER / name)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
