"""CAN frames in words, by the drivers of a robot: motor, message and fields."""

from drivers.contract import CanFrame, DecodedFrame
from gateway.config import RobotConfig
from gateway.core.assembly import build


class FrameWords:
    """Puts the frames of one robot into words. Raises ConfigError at construction."""

    def __init__(self, config: RobotConfig) -> None:
        robot = build(config)
        motors = [(group.bus, group.driver.decode) for group in robot.groups]
        self._decoders = [*motors, *[(port.bus, port.driver.decode) for port in robot.ports]]

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """By the driver it belongs to; None if it is nobody's."""
        for bus, decode in self._decoders:
            if bus == frame.bus:
                decoded = decode(frame)
                if decoded is not None:
                    return decoded
        return None

    def of(self, frame: CanFrame) -> str:
        """One line for a person: motor or sensor and message with its fields, behind the frame as candump writes it."""
        decoded = self.decode(frame)
        if decoded is None:
            return raw(frame)
        owner = f"{decoded.motor} " if decoded.motor else ""
        return f"{owner}{fields(decoded)} ({raw(frame)})"


def fields(decoded: DecodedFrame) -> str:
    """The message and its fields; the motor of each where several share it."""
    owners = decoded.owners or (None,) * len(decoded.fields)
    named = (
        f"{owner}.{name}={value:g}" if owner else f"{name}={value:g}"
        for (name, value), owner in zip(decoded.fields, owners, strict=True)
    )
    return " ".join((decoded.message, *named))


def raw(frame: CanFrame) -> str:
    """As candump writes it, the bus in front; behind the second # of a CAN FD frame 1 for a bit rate switch, else 0."""
    data = "R" if frame.remote else frame.data.hex().upper()
    flags = f"#{frame.bit_rate_switch:X}" if frame.fd else ""
    return f"{frame.bus} {frame.id:0{8 if frame.extended else 3}X}#{flags}{data}"
