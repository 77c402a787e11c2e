"""A violation as a test that can be kept: robot file, script, what was recorded if it matters, and a test file."""

import re
from pathlib import Path

import msgspec
import tomlkit

from gateway.config import ConfigError, load
from replay.drive.scenario import Given
from replay.drive.scenario_file import load_scenario
from replay.inject.campaign import Found
from replay.inject.injection import Recorded, run

ROBOT, SCRIPT, GIVEN = "robot.toml", "script.toml", "given.json"
_TEST = '''"""{words}

Found by a random campaign, drive {seed}; made as short as it gets.
"""

from pathlib import Path

from replay.inject.kept import still_broken


def test_{slug}() -> None:
    assert still_broken(Path(__file__).parent) == []
'''


def keep(found: Found, out: Path) -> Path:
    """Its folder, with the test in it. Raises OSError."""
    slug = re.sub(r"\W+", "_", found.law).lower()
    folder = out / f"{slug}_{found.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    drive, scenario = found.shrunk.drive, found.shrunk.scenario
    (folder / ROBOT).write_text(drive.text, encoding="utf-8")
    script = scenario.model_dump(mode="json", exclude_none=True, exclude_defaults=True, by_alias=True)
    (folder / SCRIPT).write_text(tomlkit.dumps(script), encoding="utf-8")
    (folder / GIVEN).write_bytes(msgspec.json.encode(drive.given))
    words = f"{found.law}: {found.shrunk.words}"
    (folder / f"test_{slug}_{found.seed}.py").write_text(
        _TEST.format(words=words, seed=found.seed, slug=slug), encoding="utf-8"
    )
    return folder


def still_broken(folder: Path) -> list[str]:
    """The laws that a kept drive breaks, in words; none: it is mended. Raises OSError, ConfigError."""
    config, text = load(folder / ROBOT)
    scenario = load_scenario(folder / SCRIPT)
    try:
        given = msgspec.json.decode((folder / GIVEN).read_bytes(), type=Given)
    except msgspec.DecodeError as error:
        raise ConfigError(str(folder / GIVEN), [str(error)]) from None
    return run(Recorded(folder.name, text, config, given, scenario.seconds, scenario.plant), scenario).broken
