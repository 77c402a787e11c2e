"""Runs the blocks of a page, in order, in a directory of its own: `python -m tests.docs.running PAGE`.

How this works
--------------
A block that a test covers is left out. Each other one is a shell of its own, as a person would have it who pastes the
block, with `drivegate` on the path. A block with a terminal of its own goes on while the others run, and gets a Ctrl-C
at the end of the page; the next block begins once the robot that it runs answers. All of it has its own network where
the machine allows that, with nothing in it but loopback, so that the usual port is free and a page cannot ask for
anything outside.
"""

import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from tests.docs import words
from tests.docs.pages import ROOT, Block, blocks, name

LONGEST_S: Final = 300.0
START_S: Final = 90.0
END_S: Final = 60.0
ENDINGS: Final = (0, 130, -signal.SIGINT)  # of what a Ctrl-C ends
ALONE: Final = (("unshare", "--net"), ("unshare", "--user", "--map-root-user", "--net"))
LOOPBACK: Final = "ip link set lo up"


class BlockError(Exception):
    """Which block did not do what its page says, with its output."""


def alone() -> list[str]:
    """In front of a command that is to have a network of its own; empty where this machine does not allow it."""
    for command in ALONE:
        tried = subprocess.run([*command, "sh", "-c", LOOPBACK], capture_output=True, timeout=20, check=False)
        if tried.returncode == 0:
            return [*command, "sh", "-c", f'{LOOPBACK} && exec "$@"', "sh"]
    return []


def run(page: Path) -> Iterator[str]:
    """What went wrong on a page: nothing, or its first block that failed."""
    wrong = list(words.faults(page.read_text(encoding="utf-8")))
    if wrong:  # one that would change this computer among them
        yield from (f"{name(page)}, not run: {fault}" for fault in wrong)
        return
    command = [*alone(), sys.executable, "-m", "tests.docs.running", str(page)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=2 * LONGEST_S, check=False)
    if done.returncode != 0:
        yield f"{name(page)}: {done.stdout}{done.stderr}".strip()


def run_blocks(page: Path, folder: Path) -> int:
    """How many blocks were run, in this folder. Raises BlockError."""
    found = [block for block in blocks(page.read_text(encoding="utf-8")) if block.runs or "file" in block.markers]
    environment = os.environ | _tools(folder / "bin") | {"HOME": str(folder), "COLUMNS": "100", "TERM": "dumb"}
    here = folder / "here"
    here.mkdir()
    with _terminals() as terminals:
        for block in found:
            if "ended" in block.markers:
                _end(terminals.pop(block.markers["ended"]))
            if "file" in block.markers:
                (here / block.markers["file"]).write_text(block.text, encoding="utf-8")
            elif "terminal" in block.markers:
                terminals[block.markers["terminal"]] = _begun(block, here, environment)
            else:
                _done(block, here, environment)
    return len(found)


def _tools(folder: Path) -> dict[str, str]:
    """`drivegate` of this checkout, and this Python, on the path."""
    folder.mkdir()
    for tool, command in (("drivegate", "-m gateway"), ("python3", ""), ("python", "")):
        (folder / tool).write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {command} "$@"\n')
        (folder / tool).chmod(0o755)
    return {"PATH": f"{folder}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


def _command(block: Block) -> list[str]:
    return ["python3", "-c", block.text] if block.language == "python" else ["bash", "-euc", block.text]


def _done(block: Block, here: Path, environment: dict[str, str]) -> None:
    wanted = int(block.markers.get("exit", 0))
    done = subprocess.run(
        _command(block),
        cwd=here,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    if done.returncode != wanted:
        raise BlockError(f"line {block.line} exits with {done.returncode}, not {wanted}\n{block.text}{done.stdout}")


def _begun(block: Block, here: Path, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(
        _command(block), cwd=here, env=environment, stdin=subprocess.DEVNULL, start_new_session=True
    )
    robot = re.search(r"^drivegate run (\S+)", block.text, re.MULTILINE)
    deadline = time.monotonic() + START_S
    asked = ["drivegate", "watch", robot[1] if robot else "", "--once", "--json"]
    while robot and subprocess.run(asked, cwd=here, env=environment, capture_output=True, check=False).returncode != 0:
        if process.poll() is not None or time.monotonic() > deadline:
            raise BlockError(f"line {block.line}: nobody answers\n{block.text}")
    return process


@contextmanager
def _terminals() -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Each ends with a Ctrl-C. Raises BlockError for one that does not, or had ended before."""
    running: dict[str, subprocess.Popen[bytes]] = {}
    begun = running.values()
    try:
        yield running
        for process in begun:
            _end(process)
    finally:
        for process in begun:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGINT)
        process.wait(END_S)
    if process.returncode not in ENDINGS:
        raise BlockError(f"a terminal of its own ended with {process.returncode}")


def main(arguments: Sequence[str]) -> int:
    """0 if every block of the page did what it says."""
    page = Path(arguments[0])
    with tempfile.TemporaryDirectory() as folder:
        try:
            run_blocks(page, Path(folder))
        except (BlockError, subprocess.TimeoutExpired) as error:
            sys.stdout.write(f"{error}\n")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
