"""python-can as a service wants it: `from gateway.edges.python_can import can`.

For logs in MF4 it loads asammdf where that is installed, and with it pandas and Arrow: seconds of a start and a hundred
megabytes of a process that reads no logs (measured with 4.6). While it is imported, there is none.
"""

from gateway.edges.hidden import hidden

with hidden("asammdf"):
    import can

__all__ = ["can"]
