"""Debian's Chromium, installed where it is missing: the browsers that Playwright would download are not used."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, sync_playwright

from tests.vm import packages

PROGRAMS = ("chromium-headless-shell", "chromium")  # the first is half as large, and enough
FONT = {"/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf": "fonts-dejavu-core"}
# A page that asks for anything by a name gets no answer, also where there is a network.
OPTIONS = ["--no-sandbox", "--host-resolver-rules=MAP * ~NOTFOUND", "--disable-background-networking"]


class NoBrowserError(Exception):
    """There is none, and it could not be installed; says what to do."""


def program() -> str:
    """Of the browser; as root it is installed where it is missing. Raises NoBrowserError."""
    for wanted in ([], [PROGRAMS[0]], [PROGRAMS[1]]):
        missing = [*wanted, *packages.missing(FONT)]
        if missing:
            packages.install(missing)
        found = next(filter(None, map(shutil.which, PROGRAMS)), None)
        if found is not None:
            return found
    raise NoBrowserError(f"no browser: as root, apt-get install {PROGRAMS[1]}")


@contextmanager
def browser() -> Iterator[Browser]:
    """One without a display. Raises NoBrowserError."""
    path = program()
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=OPTIONS)
        try:
            yield opened
        finally:
            opened.close()
