"""Three robots from an empty directory to a driven square, typed on a terminal: `python -m tests.docs.three_robots`.

How this works
--------------
A person answers by what a question says, and looks at the wheels. What the terminal shows is kept in
`deploy/docs/terminal`; the call writes it anew, and `tests.docs` holds what comes out now against it, but for what
differs from day to day.
"""

import argparse
import re
import shlex
import struct
import sys
import tempfile
from collections.abc import Mapping
from difflib import unified_diff
from pathlib import Path
from typing import Final, NamedTuple

import tomlkit

from gateway.config import RobotConfig, parse
from tests.docs.generated import TERMINAL
from tests.docs.pages import ROOT
from tests.docs.running import alone
from tests.docs.terminal import PROMPT, Terminal, TerminalError, environment
from tests.setup_robots import wronged

CHANNEL: Final = "bench"
ATTEMPTS: Final = 3  # a machine that is too busy lets motors and commands be late, and robots tell so
HOME: Final = "/home/you"
SEEN: Final = 0.1  # rad, that a person sees
QUESTION: Final = r"(?:^|\n)[^\n]*\?(?: \([^\n]*\))?(?: \[[^\n]*\])? $"
WHAT_TURNED: Final = r"What turned\?[^\n]*n: nothing $"
YES: Final = r"Type yes [^\n]*: $"

ODRIVE: Final = {
    "Which motor controllers?": "odrive-0.6",
    "Do you know the endpoints": "yes",
    "Which version": "0.6.10",
    "Endpoint of enable_watchdog": "188",
    "Of watchdog_timeout": "189",
    "How often does the controller report": "250",
    "Bit rate": "1000000",
    "Largest current": "30",
}


class Story(NamedTuple):
    """What a person answers, by how a question begins (else Enter); how the robot really is: ids and directions."""

    answers: Mapping[str, str]
    ids: Mapping[str, int]
    directions: Mapping[str, int]
    steered: bool = False


STORIES: Final[dict[str, Story]] = {
    "kiwi": Story(
        {
            **{"What kind of chassis?": "omni", "Its name?": "kiwi", "How many omni wheels": "3"},
            **{"How far from the centre": "0.15", "Radius of the wheels": "0.05", "How heavy": "9"},
            **{"Motor turns per turn": "5", "Torque at the wheel": "12", "Top speed of the wheel": "30"},
            **ODRIVE,
        },
        {"wheel_1": 2, "wheel_2": 1, "wheel_3": 9},
        {"wheel_1": -1, "wheel_2": -1, "wheel_3": -1},
    ),
    "mobyish": Story(
        {
            **{"What kind of chassis?": "offset_differential", "Its name?": "mobyish"},
            **{"Radius of the driven wheels": "0.08", "How far is their axle": "0.2", "How far apart": "0.35"},
            **{"Inertia of what carries the platform": "0.9", "How heavy": "40", "Motor turns per turn": "12"},
            **{"Torque at the wheel": "25", "Top speed of the wheel": "30"},
            **ODRIVE,
        },
        {"left": 2, "right": 1, "platform": 7},
        {"left": -1, "right": 1, "platform": -1},
        steered=True,
    ),
    "rectangular": Story(
        {
            **{"What kind of chassis?": "mecanum", "Its name?": "rectangular", "From a front to a rear": "0.4"},
            **{"From left to right": "0.36", "Radius of the wheels": "0.0762", "How heavy": "20"},
            "Which motor controllers?": "c620",
        },
        {"front_left": 1, "rear_left": 3, "rear_right": 2, "front_right": 7},
        {"front_left": 1, "rear_left": 1, "rear_right": -1, "front_right": -1},
    ),
}
BUS: Final = {"Interface of python-can": "virtual", "Channel": CHANNEL}
SIDES: Final = ("--vx 0.5", "--vy 0.5", "--vx -0.5", "--vy -0.5")


class Person:
    """Stands beside the robot of a story, and types."""

    def __init__(self, name: str, folder: Path) -> None:
        self._story = STORIES[name]
        self._file = f"{name}.toml"
        self._folder = folder / "robot"
        self._folder.mkdir()
        self._true, self._eyes = folder / "true.toml", folder / "eyes"
        tools = folder / "bin"
        tools.mkdir()
        bench = [sys.executable, "-m", "tests.docs.bench", str(self._true), str(self._eyes), "drivegate"]
        (tools / "drivegate").write_text(f'#!/bin/sh\nexec {shlex.join(bench)} "$@"\n')
        (tools / "drivegate").chmod(0o755)
        told = environment(tools) | {"HOME": str(folder), "PYTHONPATH": str(ROOT)}
        self.terminal = Terminal(self._folder, told, within=alone())

    def tell(self) -> str:
        """All of the story, as the terminal shows it. Raises TerminalError."""
        self._interview()
        begun = self._text()
        self._true.write_text(wronged(begun, self._story.ids, self._story.directions))
        self.terminal.command(f"drivegate setup scan {CHANNEL} --interface virtual --ask --file {self._file}")
        self._directions(parse(begun, self._file))
        if tomlkit.parse(self._text()) != tomlkit.parse(self._true.read_text()):
            raise TerminalError(f"the robot file is not that of the robot:\n{self.terminal.shown}")
        self.terminal.command(f"drivegate check {self._file}")
        self.terminal.command("# Now the robot is put on its wheels.")
        self._square()
        self.terminal.close()
        shown = self.terminal.shown.replace(str(self._folder), HOME)
        return shown.removesuffix("exit\n").removesuffix("$ ")

    def _text(self) -> str:
        return (self._folder / self._file).read_text(encoding="utf-8")

    def _interview(self) -> None:
        self.terminal.type(f"drivegate setup new {self._file}")
        answers = BUS | dict(self._story.answers)
        while True:
            shown = self.terminal.until(QUESTION, PROMPT)
            if re.search(PROMPT, shown):
                return
            question = shown.rpartition("\n")[2]
            self.terminal.type(next((said for begin, said in answers.items() if question.startswith(begin)), ""))

    def _directions(self, config: RobotConfig) -> None:
        self.terminal.type(f"drivegate setup directions {self._file}")
        before = [0.0] * len(config.motor)
        while True:
            shown = self.terminal.until(WHAT_TURNED, YES, PROMPT)
            if re.search(PROMPT, shown):
                return
            if re.search(YES, shown):
                self.terminal.type("yes")
                continue
            now = self._looked(len(before))
            self.terminal.type(_turned(config, before, now))
            before = now

    def _looked(self, motors: int) -> list[float]:
        return list(struct.unpack(f"{motors}d", self._eyes.read_bytes()))

    def _square(self) -> None:
        self.terminal.command(f"drivegate run {self._file} 2>run.log &")
        name = self._file.removesuffix(".toml")
        self.terminal.command(f"until drivegate watch {self._file} --once >watched.txt 2>&1; do :; done")
        if self._story.steered:
            self.terminal.command(f"drivegate reference {self._file} --angle 0")
        for side in SIDES:
            self.terminal.command(f"drivegate send {self._file} {side} --for 2")
        self.terminal.command("kill %1 && wait")
        self.terminal.command(f"drivegate replay verify sessions/{name}-*")


def _turned(config: RobotConfig, before: list[float], now: list[float]) -> str:
    names = [motor.name for motor in config.motors_in_order()]
    moved = {name: new - old for name, new, old in zip(names, now, before, strict=True) if abs(new - old) > SEEN}
    if len(moved) != 1:
        return "n"
    (name, way) = next(iter(moved.items()))
    return f"{name} {'f' if way > 0.0 else 'b'}"


def told(name: str) -> str:
    """A story as it comes out now. Raises TerminalError."""
    with tempfile.TemporaryDirectory() as folder:
        return Person(name, Path(folder)).tell()


def normal(text: str) -> str:
    """A story without what differs from one day to the next: times, places driven to, counts and processes."""
    text = re.sub(r"\d{8}T\d{6}Z", "TIME", text)
    text = re.sub(r"(?m)^(\[\d\] *[-+]?) .*$", r"\1", text)
    text = re.sub(r"\d+ +│ (?=[a-z])", "N │ ", text)  # frames per second in the table of a scan
    lines = (re.sub(r"-?\d[\d,.]*", "N", line) if _measured(line) else line for line in text.splitlines())
    return "\n".join(" ".join(line.split()) for line in lines)


def _measured(line: str) -> bool:
    return bool(re.match(r"at x |.*(cycle|frame)", line))


def kept(name: str) -> Path:
    """Where a story is kept."""
    return TERMINAL / f"{name}.txt"


def changed(name: str) -> list[str]:
    """The lines in which a story comes out otherwise than it is kept, or what kept it from its end."""
    before = normal(kept(name).read_text(encoding="utf-8")).splitlines()
    lines: list[str] = []
    for _ in range(ATTEMPTS):
        try:
            now = normal(told(name)).splitlines()
        except TerminalError as error:
            lines = str(error).splitlines()
            continue
        lines = list(unified_diff(before, now, f"{name}, as kept", f"{name}, as it comes out", lineterm="", n=1))
        if not lines:
            break
    return lines


def main() -> int:
    """Writes every story down; with --check it is 1 where one comes out otherwise than it is kept."""
    parser = argparse.ArgumentParser(prog="python -m tests.docs.three_robots", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, and tell what differs from what is kept")
    parser.add_argument("name", nargs="*", help=f"of {', '.join(STORIES)}; default: all")
    wanted = parser.parse_args()
    differing = 0
    for name in wanted.name or STORIES:
        if wanted.check:
            lines = changed(name)
            differing += bool(lines)
            hint = ["where that is as it should be: python -m tests.docs.three_robots"] if lines else []
            sys.stdout.writelines(f"{line}\n" for line in (*lines, *hint))
        else:
            kept(name).write_text(told(name).rstrip() + "\n", encoding="utf-8")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
