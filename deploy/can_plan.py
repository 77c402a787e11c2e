"""Reads robot files that share a computer: prints "ROBOT CHANNEL BITRATE [DATA_BITRATE]" of each SocketCAN bus.

The data bit rate is that of a bus of CAN FD. What is wrong with a file, or between two, is said all at once (exit 78).
install.sh runs it with the Python of an environment, whose DriveGate may be of another version.
"""

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from gateway.config import ConfigError, RobotConfig, load

VIRTUAL = ("vcan", "vxcan")  # interfaces without a bit rate
ANY_PORT = ":0"
EXIT_CONFIG = 78


def main(paths: Iterable[Path]) -> int:
    """Exit code."""
    problems: list[str] = []
    lines: list[str] = []
    rates: dict[str, tuple[str, Path]] = {}  # of a channel, and who wants it so
    single: dict[str, Path] = {}  # what one robot of a computer has for itself
    for path in paths:
        try:
            config, _ = load(path)
        except ConfigError as error:
            problems.append(str(error))
            continue
        for channel, rate in buses(config):
            lines.append(f"{path.stem} {channel} {rate}")
            other, whose = rates.setdefault(channel, (rate, path))
            if other != rate and not channel.startswith(VIRTUAL):
                problems.append(
                    f"{whose} and {path}: {channel} cannot have a bitrate of {words(other)} and of {words(rate)}"
                )
        for what in own(config):
            whose = single.setdefault(what, path)
            if whose != path:
                problems.append(f"{whose} and {path}: both have {what}, which only one robot of a computer can have")
    if problems:
        sys.stderr.write("\n".join(problems) + "\n")
        return EXIT_CONFIG
    sys.stdout.writelines(f"{line}\n" for line in lines)
    return 0


def buses(config: RobotConfig) -> Iterator[tuple[str, str]]:
    """Channel, and bit rate or bit rates, of each SocketCAN bus."""
    for bus in config.bus:
        if bus.interface == "socketcan":
            yield bus.channel, f"{bus.bitrate} {bus.fd_bitrate}" if bus.fd else f"{bus.bitrate}"


def own(config: RobotConfig) -> Iterator[str]:
    """What a robot shares with no other."""
    yield f"robot.name = {config.robot.name!r}"
    yield from (f"zenoh.listen = {one!r}" for one in config.zenoh.listen if not one.endswith(ANY_PORT))


def words(rate: str) -> str:
    """Of a bus of CAN FD both bit rates."""
    return rate.replace(" ", " and (data) ")


if __name__ == "__main__":
    sys.exit(main(Path(one) for one in sys.argv[1:]))
