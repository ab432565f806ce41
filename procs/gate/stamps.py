"""Stamps: how far a client's own clock reading is believed. Pure."""

from __future__ import annotations

AHEAD_NS = 20_000_000
"""A record may be written after the turn that reads it began. What is stamped further ahead comes from a clock that is
not this machine's, and would stay fresh for as long as it is ahead."""


def believed_ns(t_ns: int, now_ns: int) -> int:
    """The time that counts for a condition which is looked at again and again: never later than now; 0, which is older
    than any timeout allows, for a stamp from the future."""
    return min(t_ns, now_ns) if t_ns <= now_ns + AHEAD_NS else 0
