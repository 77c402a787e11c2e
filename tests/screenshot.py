"""Picture of a session as the viewer shows it: `python -m tests.screenshot SESSION OUT.png`.

Needs no display: the native viewer renders in software (Debian: mesa-vulkan-drivers), on loopback only.
"""

import os
import socket
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from gateway.recording.disk import segments

SIZE = "1600x1000"
START_S = 30.0
LOAD_S = 4.0
DRIVER = Path("/usr/share/vulkan/icd.d/lvp_icd.x86_64.json")


def screenshot(session: Path, picture: Path) -> None:
    """Start the viewer, let it load and draw, save what it shows, end it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    program = Path(sysconfig.get_path("purelib")) / "rerun_cli" / "rerun"
    options = ["--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--port", port, "--window-size", SIZE]
    files = [str(path) for path in segments(session)] if session.is_dir() else [str(session)]
    quiet = {"CI": "1", "RUST_LOG": "error"}  # CI also keeps the viewer's telemetry off
    viewer = subprocess.Popen([program, *options, *files], env=os.environ | quiet | {"VK_ICD_FILENAMES": str(DRIVER)})
    try:
        client = _connect(f"rerun+http://127.0.0.1:{port}/proxy")
        time.sleep(LOAD_S)
        picture.write_bytes(client.take_screenshot(max_size=int(SIZE.split("x", maxsplit=1)[0])))
    finally:
        viewer.terminate()
        viewer.wait(10.0)


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
    screenshot(Path(sys.argv[1]), Path(sys.argv[2]))
