"""The stop burst: the one write that stops the wheels whatever state the board's receiver is in.

    32 x 00, STOP, 257 x 00, STOP, STOP, STOP            (397 bytes, 4.0 ms at 1 Mbaud)

A bare stop frame can be swallowed: the receiver may be waiting for the rest of a frame that was cut short, and takes
up to 256 bytes of whatever follows for it (firmware source). Each part has its use:

- Zeros are the safe filler. The receiver ignores them between frames; where it waits for a function they make an empty
  SYS frame, which does nothing; where it waits for a length they make it 0. Stop frames as filler would not do: `AA`
  is taken for a length of 170, and as the rest of a cut motor frame they can put a wheel id in it that is none.
- 32 zeros fill up any motor frame of this package that was cut (at most 22 bytes of data and the CRC are missing). The
  receiver then drops it for its CRC: codec.motor_speeds makes no motion frame whose CRC is zero at any cut, which is
  what it takes for zeros to complete one.
- The first STOP ends at byte 59 (0.6 ms). It is parsed in every state but inside a frame with more than 31 bytes left.
- 257 zeros are more than the longest rest there is, 255 bytes of data and the CRC: a frame that began anywhere before
  them, by a byte garbled in the first STOP too, is over before the next STOP.
- Three more STOPs come after whatever stray frame the filler completed, and leave the receiver between frames.
"""

from __future__ import annotations

from failstop.board.rrc.codec import STOP

BURST: bytes = bytes(32) + STOP + bytes(257) + STOP + STOP + STOP

# How many bytes of the burst are out when the first stop is complete.
FIRST_STOP_END = 32 + len(STOP)
