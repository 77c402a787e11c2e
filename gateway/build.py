"""Which software this is: where it lies, its version, and whether its core is compiled. Pure."""

from importlib import metadata
from pathlib import Path

from gateway import arithmetic

ROOT = Path(__file__).parent.parent  # holds the packages: the checkout, or the environment's site-packages
COMPILED = Path(arithmetic.__file__).suffix != ".py"
FORM = "compiled core" if COMPILED else "pure Python core"


def version() -> str:
    """Version and form in words."""
    try:
        number = metadata.version("drivegate")
    except metadata.PackageNotFoundError:
        number = "not installed"
    return f"{number} ({FORM})"
