"""Lines: code for all boards whose commands and answers are lines of text."""

from __future__ import annotations

from failstop.board.wire import Reader, Sample, beyond, two_speeds

TYPE_CHECKING = False
if TYPE_CHECKING:
    import re
    from collections.abc import Callable, Sequence


class MotionLine:
    """Makes and checks the line that sets the left and right speeds. It has the methods that wire.Motion needs."""

    def __init__(self, form: re.Pattern[bytes], write: Callable[[float, float], bytes], most: float, unit: str) -> None:
        """`form` matches the line, with a group for each speed. `write` makes the line from the left and right speeds,
        and truncates both towards zero. `most` is the highest speed that the board accepts, in `unit`."""
        self._form, self._write, self._most, self._unit = form, write, most, unit

    def frame(self, both: Sequence[float], limit: float) -> bytes:
        """Return the line that sets the speeds of left and right. Raises FrameError if a speed is not within plus or
        minus `limit`."""
        return self._write(*two_speeds(both, limit, self._most, self._unit))

    def speeds(self, frame: bytes) -> tuple[float, float] | None:
        """Return left and right in a motion line, or None for other bytes."""
        found = self._form.fullmatch(frame)
        return (float(found[1]), float(found[2])) if found else None

    def check(self, frame: bytes, limit: float) -> str:
        """Return the reason to refuse these bytes as a motion line, or "" to accept them. Never raises."""
        found = self.speeds(frame)
        if found is None:
            return "not a motion line"
        if self._write(*found) != frame:
            return "not as this board's motion lines are written"
        return beyond(found, limit, self._most)


class LineReader(Reader):
    """Makes samples from the lines that a board sends."""

    def __init__(self, samples: Callable[[bytes], list[Sample]], longest: int) -> None:
        """`samples` makes the samples of one line. If an incomplete line gets longer than `longest` bytes, only its
        last `longest` bytes are kept."""
        self._samples, self._longest, self._kept = samples, longest, b""

    def feed(self, chunk: bytes) -> list[Sample]:
        *lines, rest = (self._kept + chunk).split(b"\n")
        self._kept = rest[-self._longest :]
        return [sample for line in lines for sample in self._samples(line)]
