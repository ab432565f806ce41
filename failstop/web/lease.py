"""Lease: proves that an operator's device is present. Pure: the times are arguments, and all of them are of the robot's
clock.

The robot sends a nonce, and the device answers with the nonce's HMAC. Only the newest two nonces count, and each only
once. An answer proves that the device was present when the nonce was made, not when the answer came, so an answer that
a network has held back renews nothing. A command that comes with an answer is proven by the same HMAC, and counts from
the same time.
"""

from __future__ import annotations

import hmac
from collections import deque

COUNT = 2
NONCE_BYTES = 16
PURPOSE = b"failstop lease"


def key_of(token: str) -> bytes:
    """The key with which a device makes its answers. The page may know the key, but it can't read the token."""
    return hmac.digest(token.encode(), PURPOSE, "sha256")


def answer_to(nonce: str, key: bytes) -> str:
    """The answer of a device that has this key."""
    return hmac.digest(key, nonce.encode(), "sha256").hex()


class Lease:
    """Whether one operator, at one connection, is present."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._open: deque[tuple[str, int]] = deque(maxlen=COUNT)
        self.proven_ns = 0
        """The newest moment at which the operator's device is known to have been present; 0: not yet."""

    def ask(self, random: bytes, now_ns: int) -> str:
        """A new nonce for the device."""
        nonce = random.hex()
        self._open.append((nonce, now_ns))
        return nonce

    def accept(self, nonce: str, answer: str, said: str = "") -> bool:
        """Check an answer. True if it proves something new. `said`: a command that the same answer proves."""
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
