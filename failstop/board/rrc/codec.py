"""The frames for the wheels, the ping and the buzzer, and functions that check them before they are written. The frames
for an arm are in servos.py.

The board answers no motor frame, and its motor handler checks nothing (firmware source). The handler writes out of
bounds for a wrong id, does not compare the number of wheels with the length of the frame, and accepts NaN as a speed.
So every value is checked here. An encoder either returns a frame that the board handles as intended, or raises
FrameError.
"""

from __future__ import annotations

from struct import Struct

from failstop.board import checks
from failstop.board.checks import FrameError
from failstop.board.rrc import framing
from failstop.board.rrc.framing import BUZZER, CRC_TABLE, HEAD, MOTOR_HEAD, PWM_SERVO, WHEELS, crc8, frame

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

# Faster than any wheel. A limit above this is a mistake, because it would make the check useless.
RPS_CEILING = 1000.0
PWM_SERVOS = 4

# A speed equal to the limit may be rounded up by half a unit in the last place when it becomes a float32.
_ROUNDING = 1.0 + 2.0**-23
_SMALLEST_F32 = 2.0**-149

# Head, func and len are one word, and sub-command and count another, so that fewer objects are made and compared per
# frame.
_WHEELS4 = Struct("<IHBfBfBfBfB")
_WHEELS4_WORD = 0x160355AA
_WHEELS4_COUNT = 0x0401
MOTOR_BYTES = _WHEELS4.size
_IDS = tuple(range(WHEELS))
_TONES = (20, 20_000)
_DETUNED = 8
_BUZZER = Struct("<4H")
_BUZZER_HEAD = HEAD + bytes((BUZZER, _BUZZER.size))


def speed_limit(max_rps: float) -> float:
    """Check a speed limit in turns per second, and return it. Raises FrameError unless it is 0 to RPS_CEILING."""
    return checks.number("max_rps", max_rps, 0.0, RPS_CEILING, "rps")


def wheel_speed(wheel: int, rps: float, limit: float) -> float:
    """Check a wheel's speed in turns per second, and return it. Raises FrameError unless it is within plus or minus
    `limit`."""
    return checks.number(f"speed of wheel {wheel}", rps, -limit, limit, "rps")


def motor_speeds(rps: Sequence[float], max_rps: float) -> bytes:
    """Return the 27-byte frame that sets all four wheels. `rps` has turns per second for wire ids 0 to 3 (motors 1 to
    4), each within plus or minus max_rps. Minus zero is sent as zero, so four zeros are always exactly STOP. Raises
    FrameError.

    A speed may be sent smaller by a few units in the last place of its float32. Otherwise the zeros of the stop burst
    might complete a frame that was cut short (see _complete_free).
    """
    try:
        a, b, c, d = rps
    except (TypeError, ValueError):
        raise FrameError(f"rps is {rps!r}, must be {WHEELS} speeds") from None
    limit = speed_limit(max_rps)
    a, b, c, d = (wheel_speed(wheel, value, limit) for wheel, value in enumerate((a, b, c, d)))
    return _complete_free(_WHEELS4.pack(_WHEELS4_WORD, _WHEELS4_COUNT, 0, a, 1, b, 2, c, 3, d, 0)[2:-1])


_FLOATS = (5, 10, 15, 20)
"""Where the four speeds begin in a four-wheel frame, counted from its func, which follows the head."""


def _complete_free(body: bytes) -> bytes:
    """Return a four-wheel frame: the head, `body` (func, len and data), and the CRC. Wherever this frame is cut short,
    the part before the cut moves no wheel.

    Zeros leave a CRC of zero unchanged. So if a frame were cut where its CRC so far is zero, the zeros of the stop
    burst would complete it. The board would then execute it with the speeds sent so far. On average this is possible at
    one place in 256. At such a place, this function makes the last speed before it smaller by one unit in the last
    place, and starts again with the new CRCs.
    """
    crc = 0
    for at, byte in enumerate(body):
        crc = CRC_TABLE[crc ^ byte]
        if not crc and (smaller := _one_unit_smaller(body, at)):
            return _complete_free(smaller)
    return HEAD + body + bytes((crc,))


def _one_unit_smaller(body: bytes, at: int) -> bytes:
    """Return the frame's func, len and data with one speed made smaller. This is the last speed that begins at `at` or
    earlier and is not zero. Empty if there is no such speed, because a frame that is cut at `at` then moves no
    wheel."""
    for start in reversed(_FLOATS):
        if start <= at:
            bits = int.from_bytes(body[start : start + 4], "little")
            if bits & 0x7FFFFFFF:
                return body[:start] + (bits - 1).to_bytes(4, "little") + body[start + 4 :]
    return b""


def check_motion(frame: bytes, max_rps: float) -> str:
    """Return the reason to refuse these bytes as a motion frame, in a few words, or "" to accept them. Never raises.

    It accepts only the 27-byte frame for all four wheels, with ids 0 to 3 in order and the right CRC. Every speed must
    be finite and within plus or minus max_rps (0 to RPS_CEILING turns per second), with an allowance for rounding to
    float32.
    """
    if len(frame) != _WHEELS4.size:
        return "not a motor frame"
    word, count, *entries, _ = _WHEELS4.unpack(frame)
    if word != _WHEELS4_WORD or count != _WHEELS4_COUNT:
        return "not a motor frame"
    # There is no final xor, so the CRC over a frame and its own CRC is zero.
    if crc8(frame[2:]):
        return "bad crc"
    ids, speeds = tuple(entries[::2]), entries[1::2]
    if ids != _IDS:
        return "wheel ids {} {} {} {}, must be 0 1 2 3".format(*ids)
    if not 0.0 <= max_rps <= RPS_CEILING:
        return f"limit {max_rps} rps, must be 0 to {RPS_CEILING:g}"
    limit = max_rps * _ROUNDING + _SMALLEST_F32
    for wheel, rps in enumerate(speeds):
        if not -limit < rps < limit:  # a chained comparison is false for NaN
            return f"wheel {wheel} at {rps:.2f} rps, limit {max_rps:.2f}"
    return ""


STOP = motor_speeds((0.0, 0.0, 0.0, 0.0), 0.0)


def pwm_servo_read(servo: int) -> bytes:
    """Return the ping, which asks for the pulse of a PWM servo (id 1 to 4). The board answers it from its memory, even
    if no servo is connected."""
    return frame(PWM_SERVO, bytes((0x05, checks.integer("servo id", servo, 1, PWM_SERVOS))))


def buzzer(freq_hz: int, on_ms: int, off_ms: int, repeat: int) -> bytes:
    """Return the frame that sounds the buzzer `repeat` times. Raises FrameError. An off_ms of 0 is refused, because it
    once made a buzzer sound without end.

    The tone may be a few hertz lower, or higher near the lowest tone. Otherwise the zeros of the stop burst might
    complete a cut frame with an off time of 0.
    """
    checks.integer("freq_hz", freq_hz, *_TONES)
    checks.integer("on_ms", on_ms, 1, 65_535)
    checks.integer("off_ms", off_ms, 1, 65_535)
    checks.integer("repeat", repeat, 1, 65_535)
    lowest, highest = _TONES
    near = (*range(freq_hz, max(lowest, freq_hz - _DETUNED) - 1, -1), *range(freq_hz + 1, highest + 1)[:_DETUNED])
    # Each cut excludes at most one value of the tone's low byte, so at least one of these tones remains.
    data = (_BUZZER.pack(tone, on_ms, off_ms, repeat) for tone in near)
    return frame(BUZZER, next(each for each in data if not framing.zeros_complete(BUZZER, each)))


def check_aux(frame: bytes) -> str:
    """Return the reason to refuse these bytes as a frame that is not motion, in a few words, or "" to accept them.
    Never raises.

    It accepts only a buzzer frame with the right length and CRC. The frame must not contain the start of a motor frame,
    and the zeros of the stop burst must not complete it after a cut. So even a cut frame moves nothing. All other
    frames are refused, because the firmware's handlers for them read lists past their end, and could change a wheel's
    set point."""
    if len(frame) != len(_BUZZER_HEAD) + _BUZZER.size + 1 or not frame.startswith(_BUZZER_HEAD):
        return "not a buzzer's frame"
    if crc8(frame[2:]):
        return "bad crc"
    if end := framing.zeros_complete(BUZZER, frame[4:-1]):
        return f"another sound if cut after {end} bytes of data"
    return "the start of a motor frame inside" if MOTOR_HEAD in frame else ""
