"""Lease: proves that an operator's device is present. Pure: times are arguments, and all are from the robot's clock.

The robot sends a nonce, which is a random text, and the device answers with the nonce's HMAC. The device counts as
present at the time when the nonce was made, so an answer that the network delayed is no new sign of life. Only the two
newest nonces are accepted, and each only once.

An answer can contain a driving command. The HMAC then proves the command too, and the command counts as given when the
nonce was made.
"""

from __future__ import annotations

import hmac
from collections import deque

COUNT = 2
NONCE_BYTES = 16
PURPOSE = b"failstop lease"


def key_of(token: str) -> bytes:
    """Return the key with which a device computes its answers. The page's scripts may know this key, but not the
    token."""
    return hmac.digest(token.encode(), PURPOSE, "sha256")


def answer_to(nonce: str, key: bytes) -> str:
    """Return the correct answer to a nonce, from a device that has this key."""
    # A command of a browser may hold half a character.
    return hmac.digest(key, nonce.encode("utf-8", "surrogatepass"), "sha256").hex()


class Lease:
    """Proves whether the operator at one connection is present."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._open: deque[tuple[str, int]] = deque(maxlen=COUNT)
        self.proven_ns = 0
        """The newest time at which the operator's device was certainly present (the robot's monotonic clock, ns). 0
        before the first proof."""

    def ask(self, random: bytes, now_ns: int) -> str:
        """Make a new nonce for the device. `random`: random bytes."""
        nonce = random.hex()
        self._open.append((nonce, now_ns))
        return nonce

    def accept(self, nonce: str, answer: str, said: str = "") -> bool:
        """Check an answer. Returns True if the answer is right and its nonce is newer than all nonces that were
        answered right before. `said`: a command that came with the answer, and is proved by it."""
        for asked in tuple(self._open):
            if asked[0] == nonce:
                right = answer_to(nonce + said, self._key)
                if not hmac.compare_digest(right.encode(), answer.encode("utf-8", "replace")):
                    return False
                self._open.remove(asked)
                if asked[1] > self.proven_ns:
                    self.proven_ns = asked[1]
                    return True
        return False
