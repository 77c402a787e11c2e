"""A draw-wire sensor: how far its wire is drawn out, from where its preset says.

    id    bytes 0 to 3: length, 1 um, unsigned, 0xFFFFFFFF not told; byte 4: counter and state; byte 5: checksum

The preset of the sensor is set so that it tells what is wanted, such as the width between two pairs of wheels.
"""

from struct import Struct
from typing import Final

from drivers.sensors.counted import Field, FrameLayout, Kind, Layout

LAYOUT: Final = Layout(
    frames=(FrameLayout("Length", Struct("<I"), (Field("length", 1e6, 0xFFFF_FFFF),)),),
    kinds={"range": Kind(("length",), needed=1)},
)
