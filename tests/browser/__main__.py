"""Opens reports of every kind of session in Debian's Chromium: `python -m tests.browser [--keep DIR] [NAME...]`.

Each page, in both themes, as wide as a screen and as a telephone, and printed: asks for nothing, says nothing on the
console, has figures with something in them, leaves its edges nowhere, and its words can be read. What it tells must be
what `drivegate replay info`, `verify` and `trace` tell, measured in the picture by the ticks beside it.
"""

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from math import cos, hypot, sin
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Error, Page

from tests.browser.debian import NoBrowserError, browser
from tests.browser.pages import HOSTILE, KINDS, Told, reports

CHECKS = Path(__file__).parent / "checks.js"
SIZES = ((1280, 900), (390, 844))
THEMES = ("light", "dark")
PAPER = (794, 1123)  # A4 at 96 px per inch
LARGEST = 3_000_000
LEAST_PDF = 20_000
ATTEMPTS = 5
PIXELS = 2.0  # what is measured in a picture is as good as that
PLOTS = {"Wheel speeds": ("commanded.", "speed."), "Body velocity": ("_wanted", "_measured")}

Faults = Iterator[str]


def opened(at: Browser, told: Told, theme: str, size: tuple[int, int], said: list[str]) -> Page:
    """A page with the checks in it; what it asks for and says is added to `said`."""
    page = at.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=theme)  # type: ignore[arg-type]
    page.on("console", lambda message: said.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on("request", lambda asked: said.append(f"request: {asked.url}") if asked.url != told.page.as_uri() else None)
    page.goto(told.page.as_uri(), wait_until="load")
    page.evaluate(CHECKS.read_text(encoding="utf-8"))
    return page


def looks(page: Page) -> Faults:
    """Whether everything is there, within its place and to be read."""
    for check in ("figures", "overflow", "overlaps", "contrast"):
        yield from (f"{check}: {fault}" for fault in page.evaluate(f"checks.{check}()"))


def alone(page: Page, said: list[str]) -> Faults:
    """Whether it asks for nothing, and could not."""
    yield from said
    yield from (f"it has {one}" for one in page.evaluate("checks.foreign()"))
    if page.evaluate("fetch('data:text/plain,x').then(() => true, () => false)"):
        yield "a page may fetch: there is no policy"
    if page.title() == "taken":
        yield "markup of a session was run"


def texts(page: Page, told: Told) -> Faults:
    """Whether it says what the other commands say."""
    info, verdict = told.info, told.verdict
    found: dict[str, str] = page.evaluate("checks.texts()")
    levels = [(fault["level"], fault["times"]) for fault in info["faults"]]
    expected = {
        "robot": info["robot"],
        "session": info["session"],
        "began": info["began"],
        "exit-code": str(verdict["exit_code"]),
        "word": told.report["verdict"],
        "seconds": f"{info['seconds']:,.3f}",
        "cycles": f"{info['cycles']:,}",
        "received": f"{info['frames_received']:,}",
        "sent": f"{info['frames_sent']:,}",
        "errors": str(sum(times for level, times in levels if level == "error")),
        "warnings": str(sum(times for level, times in levels if level == "warning")),
        "missing": f"{sum(gap['last_cycle'] - gap['first_cycle'] + 1 for gap in info['gaps']):,}",
        "complete": "yes" if info["complete"] else "no",
        "config-origin": info["config_origin"],
        "host": info["host"],
        "commit": info["commit"] or "not told",
        "versions": ", ".join(f"{name} {version}" for name, version in info["versions"].items()),
    }
    yield from (
        f"{key}: {found.get(key)!r}, not {value!r}" for key, value in expected.items() if found.get(key) != value
    )
    wanted = [f"compared: {verdict['cycles']:,} cycle", f" with {verdict['frames']:,} sent frame", *info["problems"]]
    wanted += [fault["text"] for fault in info["faults"]] + [fault["code"] for fault in info["faults"]]
    if verdict["first_difference"]:
        wanted += [verdict["first_difference"][key] for key in ("field", "recorded", "replayed")]
    whole = page.evaluate("document.body.textContent")
    yield from (f"does not say {words!r}" for words in wanted if words not in whole)
    if KINDS[told.name] != verdict["exit_code"] or told.report["exit_code"] != verdict["exit_code"]:
        yield f"exit code {verdict['exit_code']}"
    if told.name == "different" and HOSTILE not in whole:
        yield "words that are markup are not there as they were said"


def drawn(page: Page, told: Told) -> Faults:
    """Whether the pictures show what was measured: modes, both ends of the path, the extremes of each curve."""
    seconds = told.info["seconds"]
    for stay, (mode, begin, width, whole) in zip(told.info["modes"], page.evaluate("checks.modes()"), strict=True):
        wanted, near = (stay["t"] / seconds, stay["seconds"] / seconds), PIXELS / whole
        if mode != stay["mode"] or abs(begin - wanted[0]) > near or abs(width - wanted[1]) > near:
            yield f"{stay} is drawn as {mode}, {begin:.4f}, {width:.4f}"
    if not told.trace:
        return
    yield from _ends(page, told)
    for curve in page.evaluate("checks.curves()"):
        yield from _curve(curve, told)


def _ends(page: Page, told: Told) -> Faults:
    robots = page.evaluate("checks.robots()")
    for row, (x, y, heading) in zip((told.trace[0], told.trace[-1]), robots["places"], strict=True):
        wanted = [float(row[key]) for key in ("x", "y", "theta")]
        if hypot(x - wanted[0], y - wanted[1]) > PIXELS * robots["metre"]:
            yield f"the robot is drawn at {x:.3f}, {y:.3f} m, and was at {wanted}"
        if hypot(cos(heading) - cos(wanted[2]), sin(heading) - sin(wanted[2])) > 0.02:
            yield f"the robot looks to {heading:.3f} rad, and looked to {wanted[2]:.3f}"


def _curve(curve: dict[str, Any], told: Told) -> Faults:
    label = curve["label"]
    if curve["plot"] in PLOTS:
        name = next(name for name in PLOTS[curve["plot"]] if name.strip("._") == label)
        label = f"{curve['panel']}{name}" if name.startswith("_") else f"{name}{curve['panel']}"
    times, values = zip(*((float(row["t"]), float(row[label])) for row in told.trace if row[label]), strict=True)
    near = PIXELS / curve["pixel"]
    if abs(curve["low"] - min(values)) > near or abs(curve["high"] - max(values)) > near:
        yield f"{label} is drawn from {curve['low']:.4f} to {curve['high']:.4f}, and was {min(values)} to {max(values)}"
    slack = 0.02 * told.info["seconds"]
    if abs(curve["first"] - times[0]) > slack or abs(curve["last"] - times[-1]) > slack:
        yield f"{label} is drawn from {curve['first']:.3f} to {curve['last']:.3f} s, and was {times[0]} to {times[-1]}"


def take(page: Page, picture: Path) -> None:
    """A picture of all of it. On a busy machine the browser now and then cannot, and can at the next attempt."""
    for attempt in range(ATTEMPTS):
        try:
            page.screenshot(path=picture, full_page=True)
        except Error:
            if attempt == ATTEMPTS - 1:
                raise
        else:
            return


def faults_of(at: Browser, told: Told, keep: Path | None) -> Faults:
    """Of one page, in every way in which it is looked at."""
    if keep is not None:
        shutil.copy(told.page, keep)
    if told.page.stat().st_size > LARGEST:
        yield f"{told.page.stat().st_size} bytes"
    for theme in THEMES:
        for size in SIZES:
            said: list[str] = []
            page = opened(at, told, theme, size, said)
            found = [*looks(page), *said]
            if theme == THEMES[0]:
                found += [*texts(page, told), *drawn(page, told)]
            if keep is not None:
                take(page, keep / f"{told.name}-{theme}-{size[0]}.png")
            found += alone(page, [])
            yield from (f"{theme}, {size[0]} px: {fault}" for fault in found)
            page.close()
    yield from (f"printed: {fault}" for fault in _printed(at, told, keep))


def _printed(at: Browser, told: Told, keep: Path | None) -> Faults:
    page = opened(at, told, "light", PAPER, [])
    page.emulate_media(media="print")
    yield from looks(page)
    data = page.pdf(path=None if keep is None else keep / f"{told.name}.pdf", format="A4")
    if len(data) < LEAST_PDF:
        yield f"{len(data)} bytes"
    page.close()


def main() -> int:
    """0 if every page is as it should be; 1 if not, and where there is no browser."""
    parser = argparse.ArgumentParser(prog="python -m tests.browser", description=__doc__)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="leave the pages and pictures of them here")
    parser.add_argument("name", nargs="*", metavar="NAME", help=f"of {', '.join(KINDS)}; default: all")
    wanted = parser.parse_args()
    keep: Path | None = wanted.keep
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    broken = 0
    try:
        with browser() as at, tempfile.TemporaryDirectory() as directory:
            for told in reports(Path(directory), wanted.name or KINDS):
                found = list(faults_of(at, told, keep))
                broken += len(found)
                sys.stdout.write(f"{'FAIL' if found else 'PASS'} {told.name}: {told.page.stat().st_size} bytes\n")
                sys.stdout.writelines(f"  {fault}\n" for fault in found)
    except NoBrowserError as error:
        sys.stdout.write(f"FAIL {error}\n")
        return 1
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
