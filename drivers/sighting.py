"""What a frame of an unknown bus means to each protocol: so controllers are found before a robot file is right."""

from enum import Enum
from typing import NamedTuple


class Evidence(Enum):
    """What a frame says for there being such a controller."""

    PROOF = "proof"  # a controller says this of itself again and again
    TALK = "talk"  # of its id, but it proves nothing
    COMMAND = "command"  # a host tells it something
    AGAINST = "against"  # of the id of a proof, with a content that no such controller sends


class Sighting(NamedTuple):
    """One frame as one protocol reads it.

    `variants`: which of the driver it may be of; `told`: what it tells in words, by name. `angle`: rad at the motor
    shaft, positive as the driver counts it; of a controller that counts turns of the field alone it is that of 7 pole
    pairs. `turn`: rad after which the angle begins anew; None: it never does. `numbering`: one word for
    all of the driver's controllers that share their ids; those with another word may have the same id and be others.
    """

    driver: str
    variants: tuple[str, ...]
    id: int
    message: str
    evidence: Evidence
    told: tuple[tuple[str, str], ...] = ()
    angle: float | None = None
    velocity: float | None = None  # rad/s
    turn: float | None = None
    numbering: str = ""
