"""Errors of the user's making, which commands tell in words and not as a traceback. Light: nothing else is imported."""

from typing import ClassVar

EXIT_CONFIG = 78  # EX_CONFIG of sysexits.h; systemd must not restart into it
EXIT_UNAVAILABLE = 69  # EX_UNAVAILABLE


class UserError(Exception):
    """What a person can mend; `exit_code`: with which a command ends that cannot go on."""

    exit_code: ClassVar[int] = EXIT_UNAVAILABLE
