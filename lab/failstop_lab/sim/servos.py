"""The arm's bus servos as the board has them: a servo carries out a timed move by itself, whatever has died since.

Pure; times are CLOCK_MONOTONIC nanoseconds. What each servo was told and where it stood is kept as a track, so that a
judge can say where every joint was at any time.
"""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from struct import unpack_from

from failstop.board.rrc import servos as wire
from failstop.board.servos import (
    POSITION,
    READS,
    SERVO_MOVE,
    SERVO_STOP,
    SILENT_NS,
    SUPPLY,
    TORQUE,
    TORQUE_OFF,
    TORQUE_ON,
)
from failstop_lab.sim import upward

ARM_SERVO_IDS = (1, 2, 3, 4, 5, 10)
HOT_C = 85
"""From here on a servo lets go by itself."""
LOW_MV = 4500
SERVO_REPLY_NS = 1_200_000
NOISE = 2
"""Pulses by which an answer may be off."""
PULSES_PER_S = 1400.0
"""Faster no servo turns, whatever it is told: 60 degrees in 0.18 s."""
TRACK_KEPT = 100_000
BUS_BYTE_NS = 10e9 / 115_200
"""Ten bits on the servos' bus."""
_BUS_BYTES = {SERVO_MOVE: 10, SERVO_STOP: 6, TORQUE_OFF: 7, TORQUE_ON: 7}
"""Bytes on the servos' bus for one servo, by command."""
_COUNT_AT = {SERVO_MOVE: 3, SERVO_STOP: 1}
FAULTS = ("silent", "blocked", "unloaded", "late")
READINGS = ("temperature_c", "supply_mv")


@dataclass(slots=True)
class Leg:
    """From `begin_ns` to `end_ns` a servo turned from one position to another (pulses); it stands there since."""

    servo: int
    begin_ns: int
    begin: float
    end_ns: int
    end: float

    def at(self, t_ns: int) -> float:
        """Where it was at a time in it; before it and after it, at its ends."""
        if t_ns >= self.end_ns:
            return self.end
        if t_ns <= self.begin_ns:
            return self.begin
        share = (t_ns - self.begin_ns) / (self.end_ns - self.begin_ns)
        return self.begin + share * (self.end - self.begin)


class Servo:
    """One servo. The faults may be set at any time: `silent` answers nothing and turns all the same; `blocked` is held
    where it is; `unloaded` has let go; `late` answers when the board has given up."""

    __slots__ = ("blocked", "id", "late", "leg", "silent", "supply_mv", "temperature_c", "torque", "unloaded")

    def __init__(self, servo: int, position: float, start_ns: int) -> None:
        self.id = servo
        self.leg = Leg(servo, start_ns, position, start_ns, position)
        self.torque = False
        self.silent = self.blocked = self.unloaded = self.late = False
        self.temperature_c = 35
        self.supply_mv = 7400

    def limp(self) -> bool:
        """True while it holds nothing."""
        return not self.torque or self.unloaded or self.temperature_c >= HOT_C or self.supply_mv < LOW_MV


class Servos:
    """All that are connected; `track` is what they did, the oldest first. At power-on no torque is on."""

    def __init__(self, start_ns: int, seed: int, ids: tuple[int, ...] = ARM_SERVO_IDS) -> None:
        self._noise = Random(seed + 2).randint
        self._stale = False
        """An answer that came late lies in the firmware's buffer, and is taken for that of the next question."""
        self.by_id = {servo: Servo(servo, 500.0, start_ns) for servo in ids}
        self.track: list[Leg] = [servo.leg for servo in self.by_id.values()]

    def holds_ns(self, data: bytes) -> int:
        """How long this frame keeps the receiver from the frames after it, in ns. The firmware does not check the
        count, so a missing one may be anything, and is assumed to be the largest."""
        if not data:
            return 0
        command = data[0]
        if command in READS:
            servo = self.by_id.get(data[1]) if len(data) > 1 else None
            quick = self._stale or (servo and not servo.silent and not servo.late)
            return SERVO_REPLY_NS if quick else SILENT_NS
        if command not in _BUS_BYTES:
            return SILENT_NS
        at = _COUNT_AT.get(command)
        count = 1 if at is None else data[at] if at < len(data) else 255
        return round(count * _BUS_BYTES[command] * BUS_BYTE_NS)

    def execute(self, data: bytes, t_ns: int) -> bytes:
        """Carry out a frame's data; returns the answer's frame, or nothing. The firmware checks no count."""
        if not data:
            return b""
        command, memory = data[0], data.ljust(4 + 3 * 255, b"\0")
        if command == SERVO_MOVE:
            duration_ns = 1_000_000 * int(unpack_from("<H", memory, 1)[0])
            for index in range(memory[3]):
                servo, position = unpack_from("<BH", memory, 4 + 3 * index)
                self._move(servo, min(position, wire.HIGHEST_POSITION), duration_ns, t_ns)
        elif command == SERVO_STOP:
            for servo in memory[2 : 2 + memory[1]]:
                self._stop(servo, t_ns)
        elif command in (TORQUE_OFF, TORQUE_ON):
            for found in self._addressed(memory[1]):
                found.torque = command == TORQUE_ON
                self._stop(found.id, t_ns)
        elif command in READS:
            return upward.bus_servo(memory[1], command, self._answer(memory[1], command, t_ns))
        return b""

    def _addressed(self, servo: int) -> list[Servo]:
        if servo == wire.EVERY_SERVO:
            return list(self.by_id.values())
        return [self.by_id[servo]] if servo in self.by_id else []

    def _leg(self, servo: Servo, end: float, end_ns: int, t_ns: int) -> None:
        servo.leg = Leg(servo.id, t_ns, servo.leg.at(t_ns), end_ns, end)
        self.track.append(servo.leg)
        if len(self.track) > 2 * TRACK_KEPT:
            del self.track[:TRACK_KEPT]

    def _move(self, servo: int, position: int, duration_ns: int, t_ns: int) -> None:
        for found in self._addressed(servo):
            if found.limp() or found.blocked:
                continue
            least_ns = round(abs(position - found.leg.at(t_ns)) / PULSES_PER_S * 1e9)
            self._leg(found, float(position), t_ns + max(duration_ns, least_ns, 1), t_ns)

    def _stop(self, servo: int, t_ns: int) -> None:
        for found in self._addressed(servo):
            self._leg(found, found.leg.at(t_ns), t_ns, t_ns)

    def _answer(self, servo: int, what: int, t_ns: int) -> int | None:
        """The board's answer. A late answer makes the next question succeed, with 0, whomever it asks."""
        stale, self._stale = self._stale, False
        found = self.by_id.get(servo)
        if found and found.late:
            self._stale = True
        if stale:
            return 0
        if found is None or found.silent or found.late:
            return None
        if what == POSITION:
            return round(found.leg.at(t_ns)) + self._noise(-NOISE, NOISE)
        if what == TORQUE:
            return int(not found.limp())
        return found.supply_mv if what == SUPPLY else found.temperature_c

    def change(self, servo: int, t_ns: int, **values: object) -> None:
        """Change a servo, as people, heat and age do: its faults, `temperature_c`, `supply_mv`, `position` (turned by
        hand). Raises ValueError, KeyError."""
        found = self.by_id[servo]
        for name, value in values.items():
            if name == "position" and isinstance(value, (int, float)):
                found.leg = Leg(servo, t_ns, float(value), t_ns, float(value))
                self.track.append(found.leg)
            elif isinstance(value, bool if name in FAULTS else int) and name in (*FAULTS, *READINGS):
                setattr(found, name, value)
            else:
                raise ValueError(f"{name} = {value!r} is nothing of a servo's")
        if found.limp() or found.blocked:
            self._stop(servo, t_ns)
