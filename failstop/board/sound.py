"""Sound: tests the description of a board before the board may drive, by calling the functions of the description.

Some faults of a description would otherwise show only while wheels turn. For example, its check may let every frame
pass, its stop may have no bytes, or its scale may be NaN. The tests change nothing. But the description is a program,
so its functions may change something, hang, or end their process. So own.py runs the tests in a child process.
"""

from __future__ import annotations

import termios
from math import isfinite

from failstop.board import wire as words
from failstop.board.checks import FrameError
from failstop.board.interface import ServoBus
from failstop.board.wire import MOST_REPEATS, Answer, Battery, Imu, Obeyed, Sample, Wheels, Wire
from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from failstop.board.wire import Motion

_SIMPLE_TYPES = ("int", "bool", "str", "float", "bytes")
"""The names of simple types in annotations. Where a float is expected, an int is accepted too."""
BAUD_RATES = frozenset(int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()) - {0}
_S = 1_000_000_000
_WRITERS = 3
"""How many writers of stops there are: port owner, stopper and supervisor. Each writer has a row of repeats."""
MOST_QUESTIONS = 4
"""How many questions a description may have at most. Each question needs a word in shared memory (layout.PINGS)."""
_MOST_BYTES = 1024
"""The longest frame that is allowed, in bytes. This also limits the stop."""
_MOST_FRAMES = 16
_DIAMETERS_M = (0.03, 0.08, 0.3)
_NOISE = tuple(bytes((at * step * 73 + step) & 255 for at in range(61)) for step in range(1, 24))
"""Bytes that form no valid frame."""


class _Wrong(Exception):
    """Raised for the first fault that is found. The message says what is wrong."""


def wrong(wire: Wire) -> str:
    """Return the first fault in a description. Empty if none was found."""
    try:
        for question in (_types, _ranges, _counts, _watchdog, _proofs, _rest, _motion, _refusals, _frames, _reader):
            question(wire)
    except _Wrong as error:
        return str(error)
    return ""


def _hold(holds: bool, text: str) -> None:
    if not holds:
        raise _Wrong(text)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _asked(name: str, function: Callable[..., Any], *values: object) -> Any:
    """Call a function of the description, and return its result. Raises _Wrong if the function raises an error."""
    try:
        return function(*values)
    except (Exception, SystemExit) as error:
        given = ", ".join(map(_shown, values))
        raise _Wrong(f"{name}({given}) raises {type(error).__name__}: {error}") from error


# Each field exists, and has the right type.


def _types(wire: Wire) -> None:
    none = "must be a Watchdog; for a board without one write NO_WATCHDOG (from failstop.board.wire import NO_WATCHDOG)"
    _hold(getattr(wire, "watchdog", wire) is not None, f"WIRE.watchdog = None, {none}")
    _fields(wire, "WIRE")


def _fields(value: Data, name: str) -> None:
    fields = type(value).__annotations__
    for field in vars(value):
        _hold(field in fields, f"{name}.{field}: {type(value).__name__} has no such field")
    for field, annotation in fields.items():
        _hold(hasattr(value, field), f"{name}.{field} is missing")
        _type(getattr(value, field), annotation, f"{name}.{field}")


def _type(value: object, annotation: str, name: str) -> None:
    """Check that a value fits an annotation of wire.py."""
    annotation, optional, _ = annotation.partition(" | None")
    if optional and value is None:
        return
    if annotation.startswith("Callable["):
        _hold(callable(value), f"{name} = {_shown(value)}, must be a function")
    elif annotation.startswith("tuple["):
        _hold(isinstance(value, tuple), f"{name} = {_shown(value)}, must be a tuple")
        assert isinstance(value, tuple)
        for at, each in enumerate(value):
            _type(each, annotation[len("tuple[") : -1].removesuffix(", ..."), f"{name}[{at}]")
    elif annotation in _SIMPLE_TYPES:
        kind = type(value).__name__
        fits = kind == annotation or (kind, annotation) == ("int", "float")
        _hold(fits, f"{name} = {_shown(value)}, must be of type {annotation}")
        _hold(not isinstance(value, float) or isfinite(value), f"{name} = {value}, must be a finite number")
    else:
        fits = any(kind.__name__ == annotation for kind in type(value).__mro__) and isinstance(value, Data)
        _hold(fits, f"{name} = {_shown(value)}, must be a {annotation}")
        assert isinstance(value, Data)
        _fields(value, name)


# Numbers and their ranges.


def _ranges(wire: Wire) -> None:
    port, stop, motion = wire.port, wire.stop, wire.motion
    _hold(bool(wire.name.strip()) and wire.name.isprintable(), f"WIRE.name = {_shown(wire.name)}, must be a text")
    rates = ", ".join(str(rate) for rate in sorted(BAUD_RATES) if rate >= 9600)
    _hold(port.baud in BAUD_RATES, f"WIRE.port.baud = {port.baud}, must be a rate that serial ports have: {rates}")
    times = {
        "port.deaf_ns": (port.deaf_ns, 60 * _S),
        "stop.after_ns": (stop.after_ns, _S),
        "pace.idle_ns": (wire.pace.idle_ns, _S),
        "watchdog.after_ns": (wire.watchdog.after_ns, 3600 * _S),
        "watchdog.set_ns": (wire.watchdog.set_ns, 3600 * _S),
        "ping_ns": (wire.ping_ns, 60 * _S),
        "echo_ns": (wire.echo_ns, 60 * _S),
        **{f"stop.writes[{at}].idle_ns": (write.idle_ns, _S) for at, write in enumerate(stop.writes)},
    }
    for name, (value, most) in times.items():
        _hold(0 <= value <= most, f"WIRE.{name} = {value}, must be 0 to {most} ns")
    _hold(2 <= motion.wheels <= 4, f"WIRE.motion.wheels = {motion.wheels}, must be 2 to 4")
    for name, number in (("limit", motion.limit), ("step", motion.step), ("apart", motion.apart)):
        _hold(number > 0, f"WIRE.motion.{name} = {number:g}, must be above 0")
    _hold(motion.step < motion.limit, f"WIRE.motion.step = {motion.step:g}, must be below its limit {motion.limit:g}")
    for diameter_m in _DIAMETERS_M:
        scale = _asked("WIRE.motion.per_rps", motion.per_rps, diameter_m)
        fits = isinstance(scale, (int, float)) and isfinite(scale) and scale > 0
        _hold(fits, f"WIRE.motion.per_rps({diameter_m}) = {_shown(scale)}, must be a finite number above 0")
    if reports := wire.reports:
        _hold(0 < reports.every_ns <= 60 * _S, f"WIRE.reports.every_ns = {reports.every_ns}, must be 1 to {60 * _S} ns")
        _hold(reports.wraps >= 0, f"WIRE.reports.wraps = {reports.wraps:g}, must be 0 or more")
        for name, function in (
            ("speed_per_rps", reports.speed_per_rps),
            ("position_per_turn", reports.position_per_turn),
        ):
            for diameter_m in _DIAMETERS_M if function else ():
                assert function
                scale = _asked(f"WIRE.reports.{name}", function, motion.per_rps(diameter_m), diameter_m)
                fits = isinstance(scale, (int, float)) and isfinite(scale) and scale > 0
                _hold(fits, f"WIRE.reports.{name} = {_shown(scale)}, must be a finite number above 0")
    unanswered = wire.pace.unanswered
    _hold(unanswered is None or unanswered > 0, f"WIRE.pace.unanswered = {unanswered}, must be above 0, or None")


def _counts(wire: Wire) -> None:
    stop, asks = wire.stop, [question.ask for question in wire.questions]
    _hold(len(stop.writes) == 1, f"WIRE.stop has {len(stop.writes)} writes, must have 1")
    rows = stop.repeats_ns
    _hold(len(rows) == _WRITERS, f"WIRE.stop.repeats_ns has {len(rows)} rows, must have {_WRITERS}: one a writer")
    for at, row in enumerate(rows):
        text = f"WIRE.stop.repeats_ns[{at}] has {len(row)} times, must have 1 to {MOST_REPEATS}"
        _hold(0 < len(row) <= MOST_REPEATS, text)
        rises = row[0] == 0 and list(row) == sorted({*row})
        text = f"WIRE.stop.repeats_ns[{at}] = {_shown(row)}, must begin with 0 and rise to {_S} ns at most"
        _hold(rises and row[-1] <= _S, text)
    _hold(len(asks) <= MOST_QUESTIONS, f"WIRE has {len(asks)} questions, must have {MOST_QUESTIONS} at most")
    _hold(len({*asks}) == len(asks), "WIRE.questions: two of them ask with the same bytes, so no answer tells which")
    _hold(len(wire.port.opening) <= _MOST_FRAMES, f"WIRE.port.opening has more than {_MOST_FRAMES} frames")
    frames = {
        "stop.writes[0].data": stop.writes[0].data,
        "motion.rest": wire.motion.rest,
        **{f"port.opening[{at}]": frame for at, frame in enumerate(wire.port.opening)},
        **{f"questions[{at}].ask": ask for at, ask in enumerate(asks)},
    }
    for name, frame in frames.items():
        _hold(0 < len(frame) <= _MOST_BYTES, f"WIRE.{name} has {len(frame)} bytes, must have 1 to {_MOST_BYTES}")
    for at, identity in enumerate(wire.usb):
        parts = identity.split(":")
        hexadecimal = all(len(part) == 4 and not part.strip("0123456789abcdef") for part in parts)
        _hold(len(parts) == 2 and hexadecimal, f"WIRE.usb[{at}] = {_shown(identity)}, must be as 1a86:55d4")


def _watchdog(wire: Wire) -> None:
    watchdog, known = wire.watchdog, (words.ZERO, words.COAST, words.DISARM)
    text = f"WIRE.watchdog.does = {_shown(watchdog.does)}, must be {', '.join(known)}"
    _hold(watchdog.does in known, text)
    if not watchdog.set_ns:
        return
    _hold(watchdog.arm is not None, f"WIRE.watchdog.set_ns = {watchdog.set_ns}, and arm is None, which can't set it")
    assert watchdog.arm
    frame = _asked("WIRE.watchdog.arm", watchdog.arm, watchdog.set_ns)
    _hold(isinstance(frame, bytes) and bool(frame), f"WIRE.watchdog.arm returns {_shown(frame)}, must return a frame")


def _proofs(wire: Wire) -> None:
    known = (words.ANSWERED, words.ECHOED, words.OBSERVED)
    for at, proof in enumerate(wire.proofs):
        fits = proof in known and proof not in wire.proofs[:at]
        _hold(fits, f"WIRE.proofs[{at}] = {_shown(proof)}, must be one of {', '.join(known)}, each once")
    _hold(words.ANSWERED not in wire.proofs or bool(wire.questions), "WIRE.proofs has ANSWERED, and no question")
    _hold(words.ECHOED not in wire.proofs or wire.echo_ns > 0, "WIRE.proofs has ECHOED, and echo_ns is 0")


# Motion and the stop, each in its own form.


def _rest(wire: Wire) -> None:
    motion, zeros = wire.motion, (0.0,) * wire.motion.wheels
    for limit in (motion.limit, motion.limit / 2):
        made = _asked("WIRE.motion.frame", motion.frame, zeros, limit)
        _hold(
            made == motion.rest, f"WIRE.motion.rest = {_shown(motion.rest)}, and its frame of zeros is {_shown(made)}"
        )
        why = _check(motion, motion.rest, limit)
        _hold(why == "", f"WIRE.motion.check refuses its own rest: {why}")
    told = _speeds(motion, motion.rest)
    _hold(told == zeros, f"WIRE.motion.speeds(rest) = {_shown(told)}, must be {motion.wheels} zeros")


def _motion(wire: Wire) -> None:
    motion, sizes = wire.motion, {len(wire.motion.rest)}
    least, most = motion.step * 1.5, min(motion.limit, motion.apart / 2)
    for size in (most, most / 3, least):
        for signs in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
            asked = tuple(size * signs[wheel % 2] for wheel in range(motion.wheels))
            frame = _asked("WIRE.motion.frame", motion.frame, asked, motion.limit)
            _hold(isinstance(frame, bytes), f"WIRE.motion.frame returns {_shown(frame)}, must return bytes")
            sizes.add(len(frame))
            why = _check(motion, frame, motion.limit)
            _hold(why == "", f"WIRE.motion.check refuses its own frame of {_shown(asked)}: {why}")
            told = _speeds(motion, frame)
            near = motion.step * (1 + 1e-6) + 1e-9
            same = told is not None and len(told) == motion.wheels
            same = same and all(abs(one) <= abs(wanted) + 1e-9 and abs(one - wanted) <= near
                                for one, wanted in zip(told or (), asked, strict=True))  # fmt: skip
            _hold(same, f"WIRE.motion.speeds of the frame of {_shown(asked)} = {_shown(told)}")
            slower = size / 4
            if told and max(map(abs, told)) > slower:
                why = _check(motion, frame, slower)
                _hold(why != "", f"WIRE.motion.check lets the frame of {_shown(asked)} pass at a limit of {slower:g}")
    stop = wire.stop.writes[0].data
    for part in {stop[at : at + size] for size in sizes for at in range(len(stop))}:
        if _check(motion, part, motion.limit) == "":
            told = _speeds(motion, part)
            _hold(told is not None and not any(told), f"WIRE.stop = {_shown(stop)} holds motion, of the speeds {told}")


def _refusals(wire: Wire) -> None:
    """Check that motion.frame() refuses impossible speeds, and that motion.check() refuses bytes that are not a motion
    frame. The bits of the frame of zeros are also changed, one at a time. If motion.check() accepts such a changed
    frame, its speeds must be within the limit."""
    motion, nan, inf = wire.motion, float("nan"), float("inf")
    rest = motion.rest
    for asked in ((nan,) * motion.wheels, (inf,) * motion.wheels, (motion.limit * 2,) * motion.wheels,
                  (0.0,) * (motion.wheels + 1), ()):  # fmt: skip
        try:
            made = motion.frame(asked, motion.limit)
        except FrameError:
            continue
        except (Exception, SystemExit) as error:
            text = f"{type(error).__name__}: {error}"
            raise _Wrong(f"WIRE.motion.frame({_shown(asked)}) raises {text}; it must raise FrameError") from error
        raise _Wrong(f"WIRE.motion.frame({_shown(asked)}) returns {_shown(made)}, must raise FrameError")
    for other in (b"", rest[:-1], rest[1:], rest + rest, *_NOISE):
        _hold(_check(motion, other, motion.limit) != "", f"WIRE.motion.check lets {_shown(other)} pass as motion")
    for bit in range(8 * len(rest)):
        changed = (int.from_bytes(rest, "big") ^ 1 << bit).to_bytes(len(rest), "big")
        told = _speeds(motion, changed)
        if _check(motion, changed, motion.limit) == "":
            fits = told is not None and all(abs(speed) <= motion.limit for speed in told)
            _hold(fits, f"WIRE.motion.check lets {_shown(changed)} pass, of the speeds {_shown(told)}")


def _frames(wire: Wire) -> None:
    """Check that no question and no frame in `port.opening` sets a speed other than zero, and that no question passes
    as a motion frame."""
    asks = [(f"WIRE.questions[{at}].ask", question.ask) for at, question in enumerate(wire.questions)]
    for name, frame in asks + [(f"WIRE.port.opening[{at}]", frame) for at, frame in enumerate(wire.port.opening)]:
        told = _speeds(wire.motion, frame)
        _hold(not any(told or ()), f"{name} = {_shown(frame)} is a frame of motion, of the speeds {_shown(told)}")
    for name, frame in asks:
        _hold(_check(wire.motion, frame, wire.motion.limit) != "", f"{name} = {_shown(frame)} passes as motion")


def _check(motion: Motion, frame: bytes, limit: float) -> str:
    why = _asked("WIRE.motion.check", motion.check, frame, limit)
    text = (
        f"WIRE.motion.check({_shown(frame)}) returns {_shown(why)}, must return a text: empty when the frame may pass"
    )
    _hold(isinstance(why, str), text)
    found: str = why
    return found


def _speeds(motion: Motion, frame: bytes) -> tuple[float, ...] | None:
    told = _asked("WIRE.motion.speeds", motion.speeds, frame)
    text = f"WIRE.motion.speeds({_shown(frame)}) returns {_shown(told)}, must return finite numbers, or None"
    if told is None:
        return None
    _hold(isinstance(told, (tuple, list)) and all(isinstance(speed, (int, float)) for speed in told), text)
    _hold(all(map(isfinite, told)), text)
    return tuple(told)


# The reader.


def _reader(wire: Wire) -> None:
    reader = _asked("WIRE.reader", wire.reader)
    feed = getattr(reader, "feed", None)
    _hold(callable(feed), f"WIRE.reader() returns {_shown(reader)}, must return a Reader")
    assert feed
    samples: list[Sample] = [
        *(Answer("x"), Battery(12.0), Imu((0.0,) * 3, (0.0,) * 3)),
        *(Wheels((0.0,) * wire.motion.wheels, ()), Wheels((), (0.0,) * wire.motion.wheels)),
        Obeyed((0.0,) * wire.motion.wheels),
    ]
    for chunk in (b"", wire.motion.rest, *_NOISE):
        read = _asked("WIRE.reader().feed", feed, chunk)
        text = f"WIRE.reader().feed returns {_shown(read)}, must return a list of Samples"
        _hold(isinstance(read, (list, tuple)) and all(isinstance(each, Sample) for each in read), text)
        samples += read
    for at, question in enumerate(wire.questions):
        for sample in samples:
            _asked(f"WIRE.questions[{at}].answered_by", question.answered_by, sample)
    if wire.arm:
        arm = _asked("WIRE.arm", wire.arm, wire.port)
        _hold(isinstance(arm, ServoBus), f"WIRE.arm returns {_shown(arm)}, must return a ServoBus")
