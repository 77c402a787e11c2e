"""What sensors on a bus say of themselves, and why nothing of one is believed.

Their frames are of our own layout (drivers/sensors/counted.py), so the meanings are ours, too.
"""

from typing import Final

from gateway.words.contract import Words

SENSORS: Final[dict[str, Words]] = {
    "it has not begun to measure": Words(
        "The sensor is there and not ready.", ("it was just switched on",), ("wait; look at its supply if it stays so",)
    ),
    "out of its range": Words(
        "What is measured is beyond its range.", ("a wire too long, a body that leans too far",), ("bring it back",)
    ),
    "it reports a fault of its own": Words(
        "The sensor says that it is broken.", (), ("switch it off and on, then replace it",)
    ),
    "its frames are damaged (wrong checksum)": Words(
        "Frames of its id do not have the right checksum.",
        ("another device sends on this id", "a sensor of another layout or version"),
        ("`candump CHANNEL`: who sends on this id?",),
    ),
    "its counter stands still": Words(
        "The sensor sends the same measurement again and again.", ("it hangs",), ("switch it off and on",)
    ),
    "some of its frames are missing": Words(
        "A measurement has several frames, and not all arrive.",
        ("a full bus", "a receive buffer that overflows"),
        ("`drivegate check FILE`: the load",),
    ),
}
