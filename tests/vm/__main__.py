"""Runs the tests that need a CAN kernel (lane vcan), a booted systemd (systemd) or input devices (input)."""

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.vm import packages
from tests.vm.launcher import Result, boot_failure, in_machine, run_lane, tools
from tests.vm.plugin import LANES


def main() -> int:
    """0 if every requested lane ran and passed; a lane that cannot run has failed."""
    arguments = _parser().parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    lanes = LANES if arguments.lane is None else (arguments.lane,)
    if arguments.install:
        return _install(lanes)
    results = [_result(lane, arguments) for lane in lanes]
    for result in results:
        sys.stdout.write(f"{'PASS' if result.passed else 'FAIL'} {result.lane}: {result.text}\n")
    return 0 if all(result.passed for result in results) else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.vm", description=__doc__, allow_abbrev=False)
    parser.add_argument("--install", action="store_true", help="only install missing Debian packages (as root)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="leave junit.xml and the logs of each lane here")
    parser.add_argument("--limit", type=float, default=600.0, metavar="SECONDS", help="a lane is killed after this")
    parser.add_argument("lane", nargs="?", choices=LANES, help="default: all, one after the other")
    parser.add_argument("pytest", nargs=argparse.REMAINDER, help="passed to pytest, e.g. -k name or a file")
    return parser


def _install(lanes: Sequence[str]) -> int:
    missing = sorted({package for lane in lanes for package in _still_missing(lane)})
    sys.stdout.write(f"missing: {', '.join(missing) or 'nothing'}\n")
    return 1 if missing else 0


def _result(lane: str, arguments: argparse.Namespace) -> Result:
    missing = _still_missing(lane)
    if missing:
        return Result(lane, passed=False, text=f"cannot run, as root: apt-get install {' '.join(missing)}")
    failure = boot_failure() if in_machine(lane) else None
    if failure is not None:
        return Result(lane, passed=False, text=failure)
    return run_lane(lane, pytest_arguments=arguments.pytest, limit_s=arguments.limit, keep=arguments.keep)


def _still_missing(lane: str) -> list[str]:
    """Packages this lane lacks; as root they are installed first."""
    missing = packages.missing(tools(lane))
    if missing and os.geteuid() == 0:
        sys.stdout.write(f"installing {' '.join(missing)}\n")
        packages.install(missing)
    return packages.missing(tools(lane))


if __name__ == "__main__":
    sys.exit(main())
