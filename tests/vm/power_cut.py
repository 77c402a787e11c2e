"""`python -m tests.vm.power_cut [CUTS]`: the power goes while a robot records, on a file system of its own.

A machine boots, makes a file system on a disk that is its own, records to it, and is killed at a random moment: what
its kernel had not written is lost with it. Then the disk is looked at from outside, after the repair that every boot
begins with, and the loss is told: what had been handed to the recorder and cannot be read.

What the disk itself holds in a cache of its own is not lost here. How much is lost is told and not judged: on a busy
machine the recorder may come to write late.
"""

import os
import random
import select
import shlex
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from replay.sessions.reader import SessionError, open_session
from tests.damage import LAST
from tests.vm import packages
from tests.vm.launcher import CHECKOUT, KERNEL, machine_environment, write_machine

DISK_BYTES = 256 << 20
BOOT_LIMIT_S = 120.0
SHORTEST_S, LONGEST_S = 3.0, 9.0  # of recording
DISK, MOUNTED = "/dev/ubda", "/tmp/disk"  # in the machine, whose /tmp is its own
COMMAND = f"""
mkdir -p {MOUNTED} && mount -t ext4 {DISK} {MOUNTED} || exit 1
cd {shlex.quote(str(CHECKOUT))}
exec {shlex.quote(sys.executable)} -c 'from tests.damage import serve; serve()' {MOUNTED} "$DG_RUN/last"
"""


def cut(after_s: float) -> tuple[float, str | None]:
    """Seconds lost when the power goes so long after the first cycle, and what is wrong beyond the open end."""
    with tempfile.TemporaryDirectory(prefix="drivegate-power-") as directory:
        run = Path(directory)
        disk, last = run / "disk", run / "last"
        with disk.open("wb") as file:
            file.truncate(DISK_BYTES)
        _tool("mkfs.ext4", "-q", "-F", str(disk))
        last.write_bytes(bytes(LAST.size))
        _record_until_killed(run, disk, last, after_s)
        _, last_ns = LAST.unpack(last.read_bytes())
        _tool("e2fsck", "-f", "-y", str(disk), allowed=(0, 1))
        (run / "found").mkdir()
        _tool("debugfs", "-R", f"rdump / {run / 'found'}", str(disk))
        folders = sorted((run / "found").glob("moby-*"))
        if not folders:
            return after_s, "there is no session"
        return _loss(folders[0], last_ns, after_s)


def _loss(folder: Path, last_ns: int, after_s: float) -> tuple[float, str | None]:
    try:
        session = open_session(folder)
    except SessionError as error:
        return after_s, str(error)
    found = [inputs for inputs, _ in session.cycles()]
    whole = [inputs.cycle for inputs in found] == list(range(len(found)))
    return (
        last_ns - found[-1].now_ns
    ) * 1e-9 if found else after_s, None if whole else "cycles are missing amid others"


def _record_until_killed(run: Path, disk: Path, last: Path, after_s: float) -> None:
    (run / "command").write_text(COMMAND, encoding="utf-8")
    write_machine(run)
    kernel = ["linux.uml", *KERNEL, f"init={run}/init.sh", "DG_INIT=command", f"DG_RUN={run}", f"uml_dir={run}/"]
    with (run / "console.log").open("wb") as console:
        machine = subprocess.Popen(
            [*kernel, f"ubd0={disk}"],
            cwd=run,
            env=os.environ | {"PATH": packages.SEARCH_PATH} | machine_environment(run),
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            deadline = time.monotonic() + BOOT_LIMIT_S
            while LAST.unpack(last.read_bytes())[0] == 0:
                if machine.poll() is not None or time.monotonic() > deadline:
                    raise RuntimeError((run / "console.log").read_text(errors="replace"))
                select.select([], [], [], 0.05)
            select.select([], [], [], after_s)  # the moment is random: nothing is waited for
        finally:
            os.killpg(machine.pid, signal.SIGKILL)
            machine.wait()


def _tool(*command: str, allowed: tuple[int, ...] = (0,)) -> None:
    environment = os.environ | {"PATH": packages.SEARCH_PATH}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode not in allowed:
        raise RuntimeError(f"{command[0]}: {done.stderr}")


def main() -> int:
    """0 if every session was readable, with nothing amiss but its end."""
    cuts = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    if lacking := packages.lacking(packages.POWER_TOOLS):
        sys.stdout.write(f"{lacking}\n")
        return 1
    generator = random.Random(1)
    found = [cut(generator.uniform(SHORTEST_S, LONGEST_S)) for _ in range(cuts)]
    lost = [seconds for seconds, _ in found]
    problems = [problem for _, problem in found if problem is not None]
    sys.stdout.write(f"{cuts} cuts, loss max {max(lost):.3f} s, median {statistics.median(lost):.3f} s\n")
    sys.stdout.writelines(f"  {problem}\n" for problem in problems)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
