"""Finding robot files: a path, or the name of one that is installed on this computer or travels with the package."""

import tomllib
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from gateway.config import ConfigError
from gateway.guess import guess

INSTALLED = Path("/etc/drivegate")  # where deploy/install.sh puts them, and the service reads them
_PLACES = (
    Path(__file__).parent / "deploy" / "robots",  # installed
    Path(__file__).parent.parent / "deploy" / "robots",  # checkout
)


class Place(Enum):
    """Where a robot file was found."""

    GIVEN = "given"  # the caller said which
    INSTALLED = "installed"
    BUNDLED = "bundled"


class RobotFile(NamedTuple):
    """A robot file, and why it is that one. `instead`: the bundled one of the same name, which it stands in for."""

    path: Path
    place: Place
    instead: Path | None = None

    @property
    def words(self) -> str:
        """Which file it is, for a person who gave a name."""
        if self.place is Place.GIVEN:
            return str(self.path)
        other = "" if self.instead is None else f", not the bundled {self.instead}"
        return f"{self.path} ({self.place.value}{other})"


def installed() -> dict[str, Path]:
    """Robot files of this computer, by name."""
    return {path.stem: path for path in sorted(INSTALLED.glob("*.toml"))}


def bundled() -> dict[str, Path]:
    """Robot files that came with the package, by name."""
    return {path.stem: path for place in reversed(_PLACES) for path in sorted(place.glob("*.toml"))}


def locate(name_or_path: str) -> RobotFile:
    """The robot file meant by a path, the name of an installed file or its robot, or a bundled name, in this order.

    Raises ConfigError.
    """
    here, with_us = installed(), bundled()
    path = Path(name_or_path)
    if path.suffix == ".toml" or (path.exists() and not path.is_dir()):
        return RobotFile(path, Place.GIVEN)
    found = here.get(name_or_path) or _of_robot(name_or_path, here)
    if found is not None:
        return RobotFile(found, Place.INSTALLED, instead=with_us.get(name_or_path))
    if name_or_path in with_us:
        return RobotFile(with_us[name_or_path], Place.BUNDLED)
    raise ConfigError(name_or_path, [_nowhere(name_or_path, here, with_us)])


def find(name_or_path: str) -> Path:
    """The path of it. Raises ConfigError."""
    return locate(name_or_path).path


def find_own(name_or_path: str) -> Path:
    """The same of one that is to be corrected: none that came with the package. Raises ConfigError."""
    found = locate(name_or_path)
    if found.place is Place.BUNDLED:
        words = f"is bundled and stays as it is; correct a copy of it: cp {found.path} {name_or_path}.toml"
        raise ConfigError(name_or_path, [words])
    return found.path


def find_bundled(name_or_path: str) -> Path:
    """The same, whatever is installed here: of what shows the same on every computer. Raises ConfigError."""
    return bundled().get(name_or_path) or find(name_or_path)


def unlike(path: Path, robot: str) -> str | None:
    """A warning where a robot is called other than its file: what is named after which would surprise."""
    if path.suffix != ".toml" or path.stem == robot:
        return None
    return (
        f"robot.name = {robot!r} is not the name of its file, {path.name}: the Zenoh keys, the sessions and the "
        f"commands that drive it go by {robot!r}, its service is drivegate@{path.stem}"
    )


def _of_robot(robot: str, files: dict[str, Path]) -> Path | None:
    """The first whose robot has this name, where it is called otherwise itself."""
    return next((path for path in files.values() if _robot_name(path) == robot), None)


def _robot_name(path: Path) -> object:
    """None where it cannot be read: whoever needs that file is told why."""
    try:
        section = tomllib.loads(path.read_text(encoding="utf-8")).get("robot")
    except (OSError, ValueError, RecursionError):
        return None
    return section.get("name") if isinstance(section, dict) else None


def _nowhere(name: str, here: dict[str, Path], with_us: dict[str, Path]) -> str:
    beside = Path(f"{name}.toml")
    if beside.is_file():
        return f"no robot file of this name is installed or bundled; there is {beside} here: give it with its .toml"
    known = [
        f"{place}: {', '.join(sorted(files))}" for place, files in (("installed", here), ("bundled", with_us)) if files
    ]
    return f"no such robot file; give a path ending in .toml or one of these ({'; '.join(known)})" + guess(
        name, [*here, *with_us]
    )
