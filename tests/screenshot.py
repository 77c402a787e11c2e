"""Picture of a session as the viewer shows it: `python -m tests.screenshot SESSION OUT.png [--light]`.

Needs no display: the native viewer renders in software (Debian: mesa-vulkan-drivers), on loopback only. Headless it is
dark; its light theme it takes only from its stored settings, which it reads only with a window: so that needs Xvfb
(Debian: xvfb, libxkbcommon-x11-0). Measured with 0.41: without the version in the settings it overwrites the theme.
"""

import os
import socket
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import rerun
from rerun.experimental import ViewerClient

from gateway.recording.disk import segments

SIZE = (1600, 1000)
START_S = 30.0
LOAD_S = 6.0
DRIVER = Path("/usr/share/vulkan/icd.d/lvp_icd.x86_64.json")
QUIET = {"CI": "1", "RUST_LOG": "error"}  # CI also keeps the viewer's telemetry off


def screenshot(session: Path, picture: Path, *, light: bool = False) -> None:
    """Start the viewer, let it load and draw, save what it shows, end it."""
    files = [str(path) for path in segments(session)] if session.is_dir() else [str(session)]
    if light:
        with _light_window() as environment:
            _take(picture, ["--persist-state", *files], environment)
    else:
        _take(picture, ["--headless", *files], {})


def _take(picture: Path, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    program = Path(sysconfig.get_path("purelib")) / "rerun_cli" / "rerun"
    options = [
        "--hide-welcome-screen",
        "--bind",
        "127.0.0.1",
        "--port",
        port,
        "--window-size",
        "x".join(map(str, SIZE)),
    ]
    variables = os.environ | QUIET | {"VK_ICD_FILENAMES": str(DRIVER)} | dict(environment)
    viewer = subprocess.Popen([program, *options, *arguments], env=variables)
    try:
        client = _connect(f"rerun+http://127.0.0.1:{port}/proxy")
        time.sleep(LOAD_S)
        picture.write_bytes(client.take_screenshot(max_size=SIZE[0]))
    finally:
        viewer.terminate()
        viewer.wait(10.0)


@contextmanager
def _light_window() -> Iterator[dict[str, str]]:
    """A display, and settings of the light theme: as variables of the environment."""
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", f"{SIZE[0]}x{SIZE[1]}x24"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        with tempfile.TemporaryDirectory() as home:
            stored = Path(home) / "rerun" / "app.ron"
            stored.parent.mkdir()
            version = rerun.__version__
            stored.write_text(f'{{"rerun.version": "{version}", "egui": "(options:(theme_preference:Light))"}}')
            assert server.stdout is not None
            display = server.stdout.readline().strip()
            yield {"DISPLAY": f":{display}", "XDG_DATA_HOME": home}
    finally:
        server.terminate()
        server.wait(10.0)


def _connect(url: str) -> ViewerClient:
    deadline = time.monotonic() + START_S
    while True:
        try:
            return ViewerClient.connect(url)
        except (ConnectionError, RuntimeError):
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)


if __name__ == "__main__":
    session, picture, *rest = sys.argv[1:]
    screenshot(Path(session), Path(picture), light="--light" in rest)
