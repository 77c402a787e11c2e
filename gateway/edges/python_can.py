"""python-can as a service wants it: `from gateway.edges.python_can import can`.

For logs in MF4 it loads asammdf where that is installed, and with it pandas and Arrow: seconds of a start and a hundred
megabytes of a process that reads no logs (measured with 4.6). While it is imported, there is none.
"""

import sys

_UNWANTED = "asammdf"
_hidden = _UNWANTED not in sys.modules
if _hidden:
    sys.modules[_UNWANTED] = None  # type: ignore[assignment]  # which the import system takes for "not there"
try:
    import can
finally:
    if _hidden:
        del sys.modules[_UNWANTED]

__all__ = ["can"]
