"""Finding robot files: a path, or the name of one that travels with the package."""

from pathlib import Path

from gateway.config import ConfigError

_PLACES = (
    Path(__file__).parent / "deploy" / "robots",  # installed
    Path(__file__).parent.parent / "deploy" / "robots",  # checkout
)


def bundled() -> dict[str, Path]:
    """Robot files that came with the package, by name."""
    return {path.stem: path for place in reversed(_PLACES) for path in sorted(place.glob("*.toml"))}


def find(name_or_path: str) -> Path:
    """The robot file meant by a path or a bundled name. Raises ConfigError."""
    path = Path(name_or_path)
    if path.suffix == ".toml" or path.exists():
        return path
    known = bundled()
    if name_or_path in known:
        return known[name_or_path]
    problem = f"no such robot file; give a path ending in .toml or one of {', '.join(sorted(known))}"
    raise ConfigError(name_or_path, [problem])
