"""Opens a session in the Rerun viewer: a window where there is a display, else a page on loopback."""

import os
import subprocess
import sysconfig
from pathlib import Path
from urllib.parse import quote

from gateway.cli.output import complain, console
from gateway.recording.disk import segments

WEB_PORT = 9090
DATA_PORT = 9876


def view(session: Path) -> None:
    """Blocks until the viewer is closed (Ctrl-C ends the served page). Never listens beyond loopback."""
    program = Path(sysconfig.get_path("purelib")) / "rerun_cli" / "rerun"
    if not program.exists():
        complain(f"the Rerun viewer is not installed with this Python; open {session} with `rerun`")
        return
    files = [str(path) for path in segments(session)]
    command = [str(program), "--bind", "127.0.0.1", "--port", str(DATA_PORT)]
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        command += ["--serve-web", "--web-viewer-port", str(WEB_PORT)]
        url = quote(f"rerun+http://127.0.0.1:{DATA_PORT}/proxy", safe="")
        console.print(f"look at http://127.0.0.1:{WEB_PORT}/?url={url} (Ctrl-C ends it)", highlight=False)
    try:
        subprocess.run([*command, *files], check=False)
    except KeyboardInterrupt:
        return
