"""The Debian packages a lane needs, and their installation."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

SEARCH_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin:/usr/lib/systemd:/lib/systemd"

HOST_TOOLS = {"ip": "iproute2", "tc": "iproute2", "candump": "can-utils", "cansend": "can-utils"}
MACHINE_TOOLS = HOST_TOOLS | {"linux.uml": "user-mode-linux", "insmod": "kmod"}
SYSTEMD_TOOLS = MACHINE_TOOLS | {"systemctl": "systemd", "systemd": "systemd", "udevadm": "udev"}
DISK_TOOLS = dict.fromkeys(("mkfs.ext4", "e2fsck", "debugfs"), "e2fsprogs")
POWER_TOOLS = MACHINE_TOOLS | DISK_TOOLS
COMPILER_TOOLS = {"cc": "gcc", "/usr/include/elf.h": "libc6-dev"}
KERNEL_SOURCE = "/usr/src/linux-source-6.1.tar.xz"
MODULE_TOOLS = COMPILER_TOOLS | {
    **{KERNEL_SOURCE: "linux-source-6.1", "make": "make", "flex": "flex", "bison": "bison"},
    **{"bc": "bc", "xz": "xz-utils", "ld": "binutils"},
}


def missing(tools: Mapping[str, str]) -> list[str]:
    """Packages to install before these tools (commands, or files by their path) exist."""
    return sorted({package for tool, package in tools.items() if not _exists(tool)})


def lacking(tools: Mapping[str, str]) -> str | None:
    """What there is to be done before these tools exist, in words; as root it is tried first. None: nothing."""
    wanted = missing(tools)
    if wanted and os.geteuid() == 0:
        sys.stdout.write(f"installing {' '.join(wanted)}\n")
        install(wanted)
        wanted = missing(tools)
    return f"cannot run, as root: apt-get install {' '.join(wanted)}" if wanted else None


def _exists(tool: str) -> bool:
    return Path(tool).is_file() if tool.startswith("/") else shutil.which(tool, path=SEARCH_PATH) is not None


def install(packages: list[str]) -> None:
    """Install quietly; refresh the package lists only if the first attempt says so."""
    if not _apt("install", "--no-install-recommends", *packages):
        _apt("update")
        _apt("install", "--no-install-recommends", *packages)


def _apt(*arguments: str) -> bool:
    command = ["apt-get", "-y", "-qq", "-o", "Dpkg::Use-Pty=0", *arguments]
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    done = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    return done.returncode == 0
