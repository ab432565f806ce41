"""The stop burst: one write that stops the wheels, whatever state the board's receiver is in.

    32 x 00, STOP, 257 x 00, STOP, STOP, STOP            (397 bytes, 4.0 ms at 1 Mbaud)

A stop frame alone can get lost. If an earlier frame was cut short, the receiver takes up to 256 of the following bytes
as the rest of that frame (firmware source). So the burst has these parts:

- Zeros are a safe filler. Between frames the receiver ignores zeros. If it waits for a function, they make an empty SYS
  frame, which does nothing. If it waits for a length, they make the length 0. Stop frames are not a safe filler: `AA`
  could become a length of 170, and in a cut motor frame they could make an invalid wheel id.
- 32 zeros complete any cut motor frame of this package, because at most 22 bytes of data and the CRC are missing. The
  receiver then drops the frame because of its wrong CRC. The CRC would be right only if it was zero at the cut, and
  codec.motor_speeds makes no motion frame for which this is possible.
- The first STOP ends at byte 59 (0.6 ms). The receiver parses it unless it is inside a frame that lacks more than 31
  bytes of its data.
- 257 zeros are more than the longest possible rest of a frame (255 bytes of data and the CRC). So every frame that
  began before them is over before the next STOP, even if it began with a garbled byte in the first STOP.
- Three more STOPs stop the wheels after any stray frame that the filler completed. They also leave the receiver between
  frames.
"""

from __future__ import annotations

from failstop.board.rrc.codec import STOP

BURST: bytes = bytes(32) + STOP + bytes(257) + STOP + STOP + STOP

# The length of the burst's beginning, up to the end of its first stop frame, in bytes.
FIRST_STOP_END = 32 + len(STOP)
