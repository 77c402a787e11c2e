"""The site in Debian's Chromium, in both themes, on a screen and on a telephone.

It gets its files by an address that is nobody's, answered from the disk, so that whatever else is asked for is seen.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from playwright.sync_api import Browser, Error, Page, Route

from tests.browser.debian import browser

ADDRESS: Final = "http://site.invalid"
SIZES: Final = ((1280, 900), (390, 844))
THEMES: Final = ("light", "dark")
SOUGHT: Final = "fault_stall"
FOUND: Final = re.compile(r"[1-9]\d* results")
WAIT_MS: Final = 5_000
ATTEMPTS: Final = 6
WIDER: Final = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
FORMULAE: Final = (
    "[...document.querySelectorAll('math')]"
    ".filter(one => one.getBoundingClientRect().width < 1 || !one.closest('p, li, td, .formula')).length"
)
IMAGES: Final = "[...document.images].filter(one => one.naturalWidth < 1).map(one => one.src)"


def faults(site: Path, keep: Path | None) -> Iterator[str]:
    """What is wrong with how the pages look. Raises NoBrowserError."""
    with browser() as at:
        for page in sorted(site.rglob("*.html")):
            name = str(page.relative_to(site))
            for theme in THEMES:
                for size in SIZES:
                    opened, said = _opened(at, site, name, theme, size)
                    found = [*said, *_looks(opened)]
                    if keep is not None:
                        opened.screenshot(path=keep / f"{name.replace('/', '-')}-{theme}-{size[0]}.png")
                    yield from (f"{name}, {theme}, {size[0]} px: {one}" for one in found)
                    opened.close()
        yield from _searched(at, site)


def _opened(at: Browser, site: Path, name: str, theme: str, size: tuple[int, int]) -> tuple[Page, list[str]]:
    """A page; what it says, and asks for besides."""
    said: list[str] = []
    page = at.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=theme)  # type: ignore[arg-type]
    page.on("console", lambda message: said.append(f"says {message.text}"))
    page.on("pageerror", lambda error: said.append(f"fails: {error}"))

    def answer(route: Route) -> None:
        asked = urlsplit(route.request.url)
        file = site / asked.path.lstrip("/")
        if f"{asked.scheme}://{asked.netloc}" == ADDRESS and file.is_file():
            route.fulfill(path=file)
            return
        said.append(f"asks for {route.request.url}")
        route.abort()

    page.route("**/*", answer)
    page.goto(f"{ADDRESS}/{name}", wait_until="load")
    return page, said


def _looks(page: Page) -> Iterator[str]:
    if (wider := page.evaluate(WIDER)) > 0:
        yield f"{wider} px wider than the screen"
    if hidden := page.evaluate(FORMULAE):
        yield f"{hidden} formulae are not drawn, or not in their place"
    yield from (f"no picture at {source}" for source in page.evaluate(IMAGES))


def _searched(at: Browser, site: Path) -> Iterator[str]:
    """A word that is on a page is found."""
    page, said = _opened(at, site, "index.html", THEMES[0], SIZES[0])
    field = page.locator("input:visible").first
    for attempt in range(ATTEMPTS):  # what is typed before the page is ready is forgotten
        try:
            if not field.is_visible():
                page.keyboard.press("Control+k")
            field.fill("", timeout=WAIT_MS)
            field.fill(SOUGHT, timeout=WAIT_MS)
            page.get_by_text(FOUND).wait_for(timeout=WAIT_MS)
            break
        except Error as error:
            if attempt == ATTEMPTS - 1:
                yield f"{SOUGHT} is not found: {error.message.splitlines()[0]}"
    yield from said
    page.close()
