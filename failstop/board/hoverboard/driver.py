"""The frames that a driver may write to hoverboard-firmware-hack-FOC, and the feedback that the driver gets.

A driver writes frames of eight bytes, ten to a hundred times a second, and expects the board's feedback without asking.
The board finds a frame by the silence before and after it. A pseudo-terminal does not pass on silences, so failstop
finds a frame by its start instead. The wheel speeds are computed as the board mixes them, whatever the driver meant.

A cut frame and the first bytes of the next frame may look like one frame with a valid check, and with any speed. For
example, the cut frame cdab0000 and the first half of a stop look like full speed backward. So eight bytes with another
start among them are not accepted as a frame. No driver writes a speed that looks like a start.

Firmware source: commit a0751d5. Its feedback has 18 bytes. The fork for hoverboard-robotics' ROS driver sends 22
(24955d6), and a branch that also sends two currents sends 26 (c7152c1). The driver was built for the board that it has,
so it gets the feedback frames unchanged.
"""

from __future__ import annotations

from struct import Struct

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.board.hoverboard import codec

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    Row = DriverMotion | DriverAnswer | DriverFrame | DriverRefusal

PATIENCE_NS = 1_000_000_000
"""How long a driver waits for feedback before it considers the board disconnected, in ns. A driver waits for nothing
else, because this board has no questions."""
_COMMAND = Struct("<HhhH")
_HEAD = codec.START.to_bytes(2, "little")
_BODY = _COMMAND.size - len(_HEAD)
"""The place in a frame where the check begins. failstop refuses a frame with another start before this place. The check
itself may look like a start, because it has the value of the start whenever steer and speed are equal."""
_TOGETHER_NS = 20_000_000
"""How long failstop waits for the rest of a frame before it drops the frame, in ns. An adapter may hold bytes back for
16 ms, so this is longer. The board itself drops an incomplete frame as soon as the line is idle."""
_LENGTHS = (18, 22, 26)
_REST = (0.0, 0.0)
_NO_FRAME = DriverRefusal(
    "bytes that are not a frame",
    "the board would ignore them and drive on, so the wheels were stopped: is the driver made for this board?",
)


class HoverboardDriver:
    """Reads the frames that one driver program writes to the guard port, and returns the feedback that the driver
    gets."""

    def __init__(self) -> None:
        self.openers, self.patience_ns, self.past_ns = 1, PATIENCE_NS, 0
        self._kept = b""
        """The beginning of a frame that is not complete yet."""
        self._kept_ns = 0
        self._heard = b""
        self._length = 0
        """The length of the board's feedback frames, in bytes. 0 while it is not known."""

    def wrote(self, chunk: bytes, now_ns: int) -> list[Row]:
        """Return the rows (see failstop/board/driver.py) that these bytes from the driver ask for."""
        rows: list[Row] = []
        if not chunk:
            return rows
        if self._kept and now_ns - self._kept_ns > _TOGETHER_NS:
            self._kept = b""
            rows += _dropped()
        data, at = self._kept + chunk, 0
        self._kept_ns = now_ns
        while at < len(data):
            frame = data[at : at + _COMMAND.size]
            if not frame.startswith(_HEAD[: len(frame)]):
                rows += _dropped()
                at = _start(data, at)
            elif len(frame) < _COMMAND.size:
                break
            elif speeds := _speeds(frame):
                rows.append(DriverMotion(speeds))
                at += len(frame)
            else:
                rows += _dropped()
                at = _start(data, at + 1)
        self._kept = data[at:]
        return rows

    def resume(self, before: HoverboardDriver) -> None:
        """Continue the conversation `before` with the same driver."""
        self._kept, self._kept_ns, self._length = before._kept, before._kept_ns, before._length

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        """Return the board's feedback for the driver, in whole frames."""
        data, at = self._heard + chunk, 0
        frames: list[bytes] = []
        while (at := data.find(_HEAD, at)) >= 0:
            if length := self._whole(data, at):
                self._length = length
                frames.append(data[at : at + length])
                at += length
            elif len(data) < at + max(_LENGTHS) + len(_HEAD):
                break
            else:
                at += 1
        # If no start was found, the last byte may still be the first byte of one.
        self._heard = data[at:] if at >= 0 else data[-1:]
        return frames

    def _whole(self, data: bytes, at: int) -> int:
        """Return the length of the feedback frame that begins at `at`, or 0 if no frame begins there. A frame as long
        as the one before it counts at once. Any other frame counts only if another start follows it, because parts of
        two frames can look like one frame with a valid check."""
        if self._length and _checked(data[at : at + self._length], self._length):
            return self._length
        for length in _LENGTHS:
            if data.startswith(_HEAD, at + length) and _checked(data[at : at + length], length):
                return length
        return 0


def _start(data: bytes, at: int) -> int:
    """Return where the next frame starts, not before `at`. If no start is found, return the length of the data, or the
    place of the last byte if this may be the first byte of a start."""
    found = data.find(_HEAD, at)
    return found if found >= 0 else len(data) - data.endswith(_HEAD[:1])


def _dropped() -> list[Row]:
    return [_NO_FRAME, DriverMotion(_REST, refused=True)]


def _speeds(frame: bytes) -> tuple[float, float] | None:
    """Return left and right in a frame, as the board clamps and mixes them. None if the bytes are not a frame."""
    start, steer, speed, check = _COMMAND.unpack(frame)
    if start != codec.START or check != start ^ (steer & 0xFFFF) ^ (speed & 0xFFFF):
        return None
    if _HEAD in frame[1 : _BODY + 1]:
        return None
    return codec.wheels(_clamped(steer), _clamped(speed))


def _clamped(word: int) -> int:
    most = int(codec.LIMIT)
    return max(-most, min(word, most))


def _checked(frame: bytes, length: int) -> bool:
    if len(frame) != length:
        return False
    check = 0
    for at in range(0, length, 2):
        check ^= frame[at] | frame[at + 1] << 8
    return not check


def language(_settings: Mapping[str, float | str]) -> HoverboardDriver:
    """Make a HoverboardDriver for a program that has opened the guard port. The settings are not needed."""
    return HoverboardDriver()
