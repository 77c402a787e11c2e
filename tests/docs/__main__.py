"""The documentation, strictly and offline: `python -m tests.docs [--keep DIR] [site pages robots looks]`.

`site`: it is built, its links and those of the README lead somewhere, it loads nothing from elsewhere, and the commands
that it names are there. `pages`: the blocks of every page are run, but for those that name a test which covers them.
`robots`: what is kept of three robots at a terminal is what comes out. `looks`: every page in Debian's Chromium.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, TypeVar

from tests.docs import running, site, words
from tests.docs.pages import ROOT, blocks, name, sources
from tests.docs.three_robots import STORIES

PARTS: Final = ("site", "pages", "robots", "looks")
AT_ONCE: Final = 4
_T = TypeVar("_T")


def main() -> int:
    """0 if the documentation is as it should be."""
    parser = argparse.ArgumentParser(prog="python -m tests.docs", description=__doc__)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="leave the site here, and pictures of it")
    parser.add_argument("part", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; default: all")
    wanted = parser.parse_args()
    parts = wanted.part or PARTS
    if unknown := set(parts) - set(PARTS):
        parser.error(f"{', '.join(sorted(unknown))}: there is {', '.join(PARTS)}")
    with tempfile.TemporaryDirectory() as folder:
        passed = [_said(part, found) for part, found in _checks(parts, Path(folder), wanted.keep)]
    return 0 if all(passed) else 1


def _checks(parts: Sequence[str], folder: Path, keep: Path | None) -> Iterator[tuple[str, Iterable[str]]]:
    try:
        built = site.build(folder)
    except site.SiteError as error:
        yield "site", [str(error)]
        return
    if keep is not None:
        shutil.copytree(built, keep / "site", dirs_exist_ok=True)
    if "site" in parts:
        yield "site", [*site.broken(built), *_in_sources()]
    if "looks" in parts:
        yield "looks", _looked(built, keep)
    if "pages" in parts:
        yield from _at_once(running.run, [page for page in sources() if _runs(page)], name)
    if "robots" in parts:
        yield from ((robot, _story(robot)) for robot in STORIES)  # by the clock: one after the other


def _in_sources() -> Iterator[str]:
    for page in sources():
        yield from (f"{name(page)}: {fault}" for fault in words.faults(page.read_text(encoding="utf-8")))
        yield from site.broken_in_repository(page)


def _looked(built: Path, keep: Path | None) -> list[str]:
    # The site can be built without a browser, and without what drives one.
    from tests.browser.debian import NoBrowserError  # noqa: PLC0415
    from tests.docs import looks  # noqa: PLC0415

    try:
        return list(looks.faults(built, keep))
    except NoBrowserError as error:
        return [str(error)]


def _runs(page: Path) -> bool:
    return any(block.runs for block in blocks(page.read_text(encoding="utf-8")))


def _story(robot: str) -> Iterator[str]:
    command = [sys.executable, "-m", "tests.docs.three_robots", "--check", robot]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode != 0:
        yield f"{done.stdout}{done.stderr}".strip()


def _at_once(
    check: Callable[[_T], Iterable[str]], things: Sequence[_T], called: Callable[[_T], str]
) -> Iterator[tuple[str, Iterable[str]]]:
    """Several side by side where each has a network of its own: else they would want the same port."""
    workers = min(AT_ONCE, os.cpu_count() or 1) if running.alone() else 1
    with ThreadPoolExecutor(workers) as pool:
        for thing, found in zip(things, pool.map(lambda one: list(check(one)), things), strict=True):
            yield called(thing), found


def _said(what: str, faults: Iterable[str]) -> bool:
    """Whether it passed."""
    found = list(faults)
    sys.stdout.write(f"{'FAIL' if found else 'PASS'} {what}\n")
    sys.stdout.writelines(f"  {fault}\n" for fault in found)
    sys.stdout.flush()
    return not found


if __name__ == "__main__":
    sys.exit(main())
