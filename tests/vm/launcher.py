"""Runs pytest where SocketCAN or systemd are real: in User-Mode Linux, or on the host's own kernel if it has vcan.

The machine is a Linux kernel that runs as an ordinary process. Its root is an overlay: below it the host's files, above
it memory, so the checkout, the interpreter and its packages are at the same paths as outside and nothing is written to
the host. One directory is shared for writing, the run directory: init.sh and the command go in, results come out.
"""

import contextlib
import functools
import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import sysconfig
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from time import monotonic
from typing import IO, NamedTuple
from xml.etree import ElementTree

from tests.vm import input_modules, packages, xstate

HERE = Path(__file__).parent
CHECKOUT = HERE.parents[1]
MEMORY_BYTES = 2 << 30  # taken from the host only as far as it is used
BOOT_LIMIT_S = 60.0  # it takes two to three
POWER_OFF = "sync; echo o >/proc/sysrq-trigger; sleep 60"

# Without these a boot takes a second longer: RAID benchmarks, 256 old-style terminals, messages nobody reads.
KERNEL = (
    *("root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", f"mem={MEMORY_BYTES >> 20}M"),
    *("con=null", "con0=fd:0,fd:1", "quiet", "loglevel=1", "noreboot"),
    *("initcall_blacklist=raid6_select_algo", "pty.legacy_count=0", "lsm="),
)

# A private network namespace: no vcan0 of somebody else is touched, and it vanishes with the tests.
HOST_VCAN = 'ip link set lo up && ip link add dev vcan0 type vcan && ip link set vcan0 up && exec "$@"'


class Result(NamedTuple):
    """What came back from one lane."""

    lane: str
    passed: bool
    text: str


def tools(lane: str) -> Mapping[str, str]:
    """What this lane needs on this host, and the package of each."""
    if not in_machine(lane):
        return packages.HOST_TOOLS
    needed = packages.MACHINE_TOOLS | {"systemd": packages.SYSTEMD_TOOLS, "input": packages.MODULE_TOOLS}.get(lane, {})
    return needed | packages.COMPILER_TOOLS if _preload_needed() else needed


def in_machine(lane: str) -> bool:
    """Whether this lane runs in User-Mode Linux on this host."""
    return lane != "vcan" or not _host_has_vcan()


@functools.cache
def boot_failure() -> str | None:
    """Why User-Mode Linux does not come up on this host; None if it does. Boots it once, with nothing to do."""
    with tempfile.TemporaryDirectory(prefix="drivegate-vm-") as directory:
        run = Path(directory)
        _write_command(run, ["true"], last=POWER_OFF)
        try:
            _boot(run, init="command", limit_s=BOOT_LIMIT_S)
        except OSError as error:
            return str(error)
        if _read(run / "status") == "0":
            return None
        return f"User-Mode Linux does not come up on this host: {_last_words(_read(run / 'console.log'))}"


def _last_words(console: str) -> str:
    """The line of a console that says why a kernel ended; below a panic's own line there are only addresses."""
    lines = console.splitlines()
    return next((line for line in lines if "panic" in line), lines[-1] if lines else "it says nothing")


def run_lane(lane: str, *, pytest_arguments: Sequence[str], limit_s: float, keep: Path | None) -> Result:
    """Run one lane to its end, at most `limit_s`; never raises for what goes wrong in there."""
    started = monotonic()
    if keep is not None:
        (keep / lane).mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="drivegate-vm-") as directory:
        run = Path(directory)
        if lane == "input":
            try:
                input_modules.build(run)
            except input_modules.BuildError as error:
                return Result(lane, passed=False, text=str(error))
        where = _run(lane, pytest_arguments, run, limit_s)
        if keep is not None:
            _keep(run, keep / lane)
        passed, text = _verdict(run)
    return Result(lane, passed, f"{text} in {monotonic() - started:.1f} s {where}")


def _run(lane: str, pytest_arguments: Sequence[str], run: Path, limit_s: float) -> str:
    pytest_command = [sys.executable, "-m", "pytest", "-p", "tests.vm.plugin", "-p", "no:cacheprovider", "--lane", lane]
    pytest_command += [f"--junitxml={run / 'junit.xml'}", f"--color={'yes' if sys.stdout.isatty() else 'no'}"]
    pytest_command += pytest_arguments
    if not in_machine(lane):
        _write_command(run, pytest_command, last="")
        _stream([*_host_vcan(), "sh", str(run / "command")], run, limit_s, environment={"TMPDIR": str(run)})
        return "on the host's vcan"
    journal = f"[ $(cat {run}/status) = 0 ] || journalctl -b >{run}/journal.log; " if lane == "systemd" else ""
    _write_command(run, pytest_command, last=journal + POWER_OFF)
    _boot(run, init="systemd" if lane == "systemd" else "command", limit_s=limit_s)
    return f"in User-Mode Linux (tests began after {_read(run / 'boot') or '?'} s)"


def _boot(run: Path, *, init: str, limit_s: float) -> None:
    """Run the command of the run directory in the machine. Raises OSError where the host needs what it cannot have."""
    write_machine(run)
    kernel = ["linux.uml", *KERNEL, f"init={run}/init.sh", f"DG_INIT={init}", f"DG_RUN={run}", f"uml_dir={run}/"]
    _stream(kernel, run, limit_s, pin=True, environment=machine_environment(run))


def machine_environment(run: Path) -> dict[str, str]:
    """What the machine's process needs to know."""
    environment = {"TMPDIR": _memory_directory(run)}
    if _preload_needed():
        environment["LD_PRELOAD"] = str(xstate.build_preload(run))
    return environment


@functools.cache
def _preload_needed() -> bool:
    return xstate.preload_needed(xstate.host_area())


def _write_command(run: Path, pytest_command: Sequence[str], *, last: str) -> None:
    lines = (
        f"cut -d' ' -f1 /proc/uptime >{run}/boot",
        f"export HYPOTHESIS_STORAGE_DIRECTORY={run}/hypothesis PYTHONDONTWRITEBYTECODE=1",
        f"cd {shlex.quote(str(CHECKOUT))}",
        shlex.join(pytest_command),
        f"echo $? >{run}/status",
        last,
    )
    (run / "command").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_machine(run: Path) -> None:
    """The init scripts, and the facts about this interpreter they need."""
    for script in HERE.glob("*.sh"):
        shutil.copy(script, run)
    (run / "init.sh").chmod(0o755)
    facts = {
        "CHECKOUT": str(CHECKOUT),
        "PYTHON_BASE": sys.base_prefix,
        "PYTHON_NAME": f"python{sys.version_info.major}.{sys.version_info.minor}",
        "PYTHON_PACKAGES": sysconfig.get_path("purelib"),
    }
    lines = [f"{name}={shlex.quote(value)}" for name, value in facts.items()]
    (run / "facts").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _host_vcan() -> list[str]:
    unshare = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]
    return [*unshare, "sh", "-c", HOST_VCAN, "sh"]


def _host_has_vcan() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return subprocess.run([*_host_vcan(), "true"], capture_output=True, check=False).returncode == 0


def _stream(
    command: Sequence[str], run: Path, limit_s: float, *, environment: dict[str, str], pin: bool = False
) -> None:
    """Run a process group to its end or to the limit; its output goes to the console, live, and to a file."""
    with subprocess.Popen(
        command,
        cwd=run,
        env=os.environ | {"PATH": packages.SEARCH_PATH} | environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    ) as process:
        if pin:
            _pin(process.pid)
        with _ended_with(process, limit_s), (run / "console.log").open("wb") as log:
            assert process.stdout is not None
            _copy(process.stdout, log)


def _pin(pid: int) -> None:
    # The kernel and its programs are separate host processes that hand over at every system call: on one CPU that is
    # four to five times faster than across two.
    cpus = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(pid, {cpus[pid % len(cpus)]})


@contextlib.contextmanager
def _ended_with(process: subprocess.Popen[bytes], limit_s: float) -> Iterator[None]:
    """The whole process group is gone when this ends, whether by itself, by the limit or by an exception."""

    def kill() -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    timer = threading.Timer(limit_s, kill)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        kill()


def _copy(source: IO[bytes], log: IO[bytes]) -> None:
    while chunk := os.read(source.fileno(), 65536):
        clean = chunk.replace(b"\r\n", b"\n")
        log.write(clean)
        sys.stdout.write(clean.decode(errors="replace"))
        sys.stdout.flush()


def _memory_directory(run: Path) -> str:
    """Where the machine's memory file lies: in memory if there is room (in most containers there is not)."""
    shm = Path("/dev/shm")
    return str(shm if shm.is_dir() and shutil.disk_usage(shm).free > MEMORY_BYTES else run)


def _verdict(run: Path) -> tuple[bool, str]:
    status = _read(run / "status")
    if not status:
        return False, "no result: it crashed, hung or did not start"
    counts = _counts(run / "junit.xml")
    return status == "0" and counts.get("tests", 0) > 0, f"pytest exit {status}, {_words(counts)}"


def _counts(junit: Path) -> dict[str, int]:
    if not junit.is_file():
        return {}
    suite = ElementTree.parse(junit).getroot().find("testsuite")
    names = ("tests", "failures", "errors", "skipped")
    return {} if suite is None else {name: int(suite.get(name, "0")) for name in names}


def _words(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count or name == "tests") or "no tests"


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8").strip() if path.is_file() else ""


def _keep(run: Path, target: Path) -> None:
    for name in ("junit.xml", "console.log", "journal.log"):
        if (run / name).is_file():
            shutil.copy(run / name, target)
