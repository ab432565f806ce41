"""Lease: the proof that an operator's device is there. Pure: the times are arguments, of the robot's clock alone.

The robot sends a nonce, the device answers with its HMAC. Only the newest two nonces count, each once, and an answer
proves the moment at which its nonce was made, not the one at which it came: what a network has held back renews
nothing. A command that comes with an answer is proven by the same HMAC, and is as old as the nonce.
"""

from __future__ import annotations

import hmac
from collections import deque

COUNT = 2
NONCE_BYTES = 16
PURPOSE = b"failstop lease"


def key_of(token: str) -> bytes:
    """The key of a device's answers, which the page may know; the token itself it can't read."""
    return hmac.digest(token.encode(), PURPOSE, "sha256")


def answer_to(nonce: str, key: bytes) -> str:
    """The proof by the device that has the key."""
    return hmac.digest(key, nonce.encode(), "sha256").hex()


class Lease:
    """Whether one operator, at one connection, is still present."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._open: deque[tuple[str, int]] = deque(maxlen=COUNT)
        self.proven_ns = 0
        """The newest moment at which the operator is known to have been there; 0: not yet."""

    def ask(self, random: bytes, now_ns: int) -> str:
        """A new nonce for the device."""
        nonce = random.hex()
        self._open.append((nonce, now_ns))
        return nonce

    def accept(self, nonce: str, answer: str, said: str = "") -> bool:
        """An answer; True when it proves something new. `said`: a command that the answer proves with it."""
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
