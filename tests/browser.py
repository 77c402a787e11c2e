"""A real browser without a display: `python -m tests.browser PAGE OUT.png [--dark]`.

Debian: chromium-headless-shell, or chromium. It has a profile of its own, and no name of any host is looked up.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
SIZE = (1400, 2400)
LOAD_S = 120.0
DARK, LIGHT = 0, 1  # Blink's PreferredColorScheme


def program() -> str:
    """Raises FileNotFoundError."""
    found = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if found is None:
        raise FileNotFoundError(f"no browser: install one of {', '.join(PROGRAMS)}")
    return found


def screenshot(page: Path, picture: Path, *, dark: bool = False, size: tuple[int, int] = SIZE) -> str:
    """Open the page and save what it shows; what the browser says to it."""
    return _run(page, f"--screenshot={picture}", f"--window-size={size[0]},{size[1]}", dark=dark).stderr


def document(page: Path) -> str:
    """The page as the browser has read it."""
    return _run(page, "--dump-dom", dark=False).stdout


def _run(page: Path, *what: str, dark: bool) -> subprocess.CompletedProcess[str]:
    with tempfile.TemporaryDirectory() as profile:
        options = [
            *("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr"),
            *("--host-resolver-rules=MAP * ~NOTFOUND", "--disable-background-networking", "--no-first-run"),
            f"--user-data-dir={profile}",
            f"--blink-settings=preferredColorScheme={DARK if dark else LIGHT}",
        ]
        command = [program(), *options, *what, page.resolve().as_uri()]
        return subprocess.run(command, capture_output=True, text=True, timeout=LOAD_S, check=True)


if __name__ == "__main__":
    page, picture, *rest = sys.argv[1:]
    sys.stderr.write(screenshot(Path(page), Path(picture), dark="--dark" in rest))
