"""The stop burst: one write that stops the wheels, whatever state the board's receiver is in.

    32 x 00, STOP, 257 x 00, STOP, STOP, STOP            (397 bytes, 4.0 ms at 1 Mbaud)

A stop frame alone can be swallowed: the receiver may be waiting for the rest of a frame that was cut short, and takes
up to 256 of the following bytes as that rest (firmware source). So the burst has five parts:

- Zeros are a safe filler. Between frames the receiver ignores them. If it waits for a function, they make an empty SYS
  frame, which does nothing; if it waits for a length, they make the length 0. Stop frames would not be safe, because
  `AA` could become a length of 170, and as the rest of a cut motor frame they could give it an invalid wheel id.
- 32 zeros fill up any motor frame of this package that was cut (at most 22 bytes of data and the CRC are missing). The
  receiver then drops it for its CRC, because codec.motor_speeds makes no motion frame whose CRC is zero at any cut, and
  zeros can complete no other.
- The first STOP ends at byte 59 (0.6 ms). It is parsed in every state except inside a frame with more than 31 bytes
  left.
- 257 zeros are more than the longest possible rest of a frame (255 bytes of data and the CRC). So a frame that began
  anywhere before them, even by a garbled byte in the first STOP, is over before the next STOP.
- Three more STOPs follow any stray frame that the filler completed, and leave the receiver between frames.
"""

from __future__ import annotations

from failstop.board.rrc.codec import STOP

BURST: bytes = bytes(32) + STOP + bytes(257) + STOP + STOP + STOP

# How many bytes of the burst are out when the first stop is complete.
FIRST_STOP_END = 32 + len(STOP)
