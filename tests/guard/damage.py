"""Damaged bytes of drivers, and the judge of what a language makes of them: no wheel turns that the board itself would
not turn."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

Speeds = list[tuple[float, ...]]


def damaged(random_: random.Random, piece: Callable[[], bytes], likely: Sequence[int], put: bytes, most: int) -> bytes:
    """A few pieces with bytes lost, changed and put in. `likely`: what a byte is changed into most often; `put`: the
    bytes that are put in; `most`: a piece that is put in is shorter."""
    text = bytearray(b"".join(piece() for _ in range(random_.randrange(1, 6))))
    for _ in range(random_.randrange(4)):
        at = random_.randrange(len(text) + 1)
        kind = random_.randrange(4)
        if kind == 0:
            del text[at : at + 1]
        elif kind == 1 and at < len(text):
            text[at] = random_.choice((*likely, random_.randrange(256)))
        elif kind == 2:
            text[at:at] = bytes((random_.choice(put),))
        else:
            text[at:at] = piece()[: random_.randrange(most)]
    return bytes(text)


def judged(chunk: bytes, motions: Callable[[bytes], Speeds], commanded: Callable[[bytes], Speeds]) -> int:
    """After each frame each wheel has the speed that the board has then, or none. Returns how many motions turned a
    wheel."""
    left = iter(commanded(chunk))
    moved = 0
    for found in motions(chunk):
        if any(found):
            moved += 1
            assert any(all(speed in (0, its) for speed, its in zip(found, own, strict=True)) for own in left), (
                chunk.hex()
            )
    return moved
