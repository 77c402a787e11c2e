"""The header of a session: what was driving, with which software, on which machine."""

import hashlib
import platform
import socket
import subprocess
from importlib import metadata

from gateway import arithmetic
from gateway.build import FORM, ROOT
from gateway.recording.packets import Hello
from gateway.recording.schema import SCHEMA_VERSION, Header

_DISTRIBUTIONS = ("drivegate", "rerun-sdk", "python-can", "eclipse-zenoh", "numpy", "pyarrow", "msgspec")
_GIT_TIMEOUT_S = 5.0


def header(hello: Hello, *, session: str, robot: str) -> Header:
    """The header as of the first segment."""
    return Header(
        schema_version=SCHEMA_VERSION,
        session=session,
        segment=1,
        robot=robot,
        config_origin=hello.config_origin,
        config_sha256=hashlib.sha256(hello.config_text.encode()).hexdigest(),
        config_text=hello.config_text,
        versions=versions(),
        git_commit=git_commit(),
        host=socket.gethostname(),
        started_wall_ns=hello.started_wall_ns,
        wall_minus_mono_ns=hello.wall_minus_mono_ns,
        sealed=True,
        plant=hello.plant,
        imported=hello.imported,
    )


def versions() -> dict[str, str]:
    """What this process runs with."""
    here = {"python": platform.python_version(), "core": FORM, "arithmetic": arithmetic.REVISION}
    return {name: _version(name) for name in _DISTRIBUTIONS} | here


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "not installed"


def git_commit() -> str | None:
    """Commit of the checkout this file lies in, `-dirty` if it was changed; None outside of one."""
    if not (ROOT / ".git").exists():
        return None
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None
