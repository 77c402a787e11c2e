"""Runs the tests that need a CAN kernel (lane vcan), a booted systemd (systemd) or input devices (input)."""

import argparse
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
    lacking = packages.lacking({tool: package for lane in lanes for tool, package in tools(lane).items()})
    sys.stdout.write(f"{lacking or 'nothing is missing'}\n")
    return 0 if lacking is None else 1


def _result(lane: str, arguments: argparse.Namespace) -> Result:
    lacking = packages.lacking(tools(lane))
    if lacking is not None:
        return Result(lane, passed=False, text=lacking)
    failure = boot_failure() if in_machine(lane) else None
    if failure is not None:
        return Result(lane, passed=False, text=failure)
    return run_lane(lane, pytest_arguments=arguments.pytest, limit_s=arguments.limit, keep=arguments.keep)


if __name__ == "__main__":
    sys.exit(main())
