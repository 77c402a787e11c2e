"""Which part of DriveGate a package belongs to: an installation need not have all, and a command says what it lacks.

The parts are the extras of pyproject.toml. What no part has, every installation has.
"""

from importlib.util import find_spec

from gateway.errors import UserError

PARTS = {  # extra: modules that it brings, and the package of each
    "robot": {
        "can": "python-can",
        "numpy": "numpy",
        "packaging": "packaging",
        "pyarrow": "pyarrow",
        "rerun": "rerun-sdk",
        "tomlkit": "tomlkit",
    },
    "desk": {
        "jinja2": "jinja2",
        "matplotlib": "matplotlib",
        "mcap": "mcap",
        "mcap_ros2": "mcap-ros2-support",
        "scipy": "scipy",
    },
}


class MissingPartError(UserError):
    """A package that this installation was not given; the text says how to get it."""


def cure(part: str) -> str:
    """How to get a part, in words."""
    return f"pip install 'drivegate[{part}]', or in a checkout: sudo sh deploy/install.sh --for {part}"


def missing(error: ModuleNotFoundError) -> MissingPartError | None:
    """In words, if it is about a package of a part; None for everything else."""
    module = (error.name or "").partition(".")[0]
    part = next((part for part, modules in PARTS.items() if module in modules), None)
    if part is None:
        return None
    package = PARTS[part][module]
    return MissingPartError(f"this needs the package {package}, which is not installed here: {cure(part)}")


def need(module: str) -> None:
    """That a package is there which only another process will import. Raises MissingPartError."""
    if find_spec(module) is None:
        raise missing(ModuleNotFoundError(name=module)) or LookupError(module)
