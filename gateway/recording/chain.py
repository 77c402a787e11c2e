"""The digest chain of a session: each batch carries a digest of itself and of everything in front of it.

How this works
--------------
It begins with the SHA-256 of a segment's header, letter by letter; in the header is the value with which the segment
before ended. Each batch and each snapshot of the core is a link: SHA-256 of the value before it, its number (first
cycle, or the cycle after which it was taken), how many cycles it has (a snapshot: none) and its bytes as they are
stored. Both values stand beside it, and the last one in the seal. So whatever is changed, taken out, put in or
exchanged is noticed, with whichever checksums put right, and what stands behind it can still be judged. It cannot tell
from the original what somebody has written anew from there to the end: for that, a value of the chain must be known
elsewhere.
"""

from hashlib import sha256
from struct import Struct
from typing import Final

_NUMBERS: Final = Struct("<qq")


def beginning(header: str) -> bytes:
    """Value in front of the first link of a segment, from its header as it is written."""
    return sha256(header.encode()).digest()


def link(before: bytes, number: int, cycles: int, stored: bytes) -> bytes:
    """Value behind a batch or a snapshot."""
    digest = sha256(before)
    digest.update(_NUMBERS.pack(number, cycles))
    digest.update(stored)
    return digest.digest()
