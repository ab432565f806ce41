"""The joints of the simulated Feetech bus for whoever judges: where each stands, what it did, whether it holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from failstop.board.feetech import codec
from failstop_lab.sim.servos import Leg, Servo, Servos

ARM_IDS = (1, 2, 3, 4, 5, 6)
MIDDLE = 2048
POSITION_AT, SUPPLY_AT, TEMPERATURE_AT = 56, 62, 63


class Bus(Protocol):
    """The bus, as far as its joints are concerned (feetech.py)."""

    memory: dict[int, bytearray]
    blocked: set[int]
    silent: set[int]
    moved: Callable[[int, int, int, int, int], None]


class BusJoint(Servo):
    """A servo in position mode, whose memory is the bus's."""

    __slots__ = ("_bus",)

    def __init__(self, bus: Bus, servo: int, start_ns: int) -> None:
        super().__init__(servo, MIDDLE, start_ns)
        self._bus = bus

    def limp(self) -> bool:
        """Its torque is off."""
        return self._bus.memory[self.id][codec.TORQUE_SWITCH] != 1


class Joints(Servos):
    """The servos of the arm, with the times of the board that the bus is behind."""

    def __init__(self, bus: Bus, start_ns: int) -> None:
        """`start_ns`: the moment that the bus's own times count from."""
        super().__init__(start_ns, 0, ())
        self._bus, self._start_ns = bus, start_ns
        joints = [BusJoint(bus, servo, start_ns) for servo in ARM_IDS]
        self.by_id = {joint.id: joint for joint in joints}
        bus.moved = self._moved

    def _moved(self, servo: int, begin_ns: int, begin: int, end_ns: int, end: int) -> None:
        """A joint has gone a step; one that goes on is on the same leg."""
        joint, start_ns = self.by_id[servo], self._start_ns
        if joint.leg.end_ns == start_ns + begin_ns and joint.leg.begin_ns < joint.leg.end_ns:
            joint.leg.end_ns, joint.leg.end = start_ns + end_ns, end
            return
        self._leg(joint, end, start_ns + end_ns, start_ns + begin_ns)
        joint.leg.begin = begin

    def change(self, servo: int, t_ns: int, **values: object) -> None:
        """As of the other servos: blocked, silent, its position, temperature (degrees Celsius) and supply. Raises
        ValueError, KeyError."""
        memory = self._bus.memory[servo]
        for name, value in values.items():
            if name in ("blocked", "silent") and isinstance(value, bool):
                those = self._bus.blocked if name == "blocked" else self._bus.silent
                (those.add if value else those.discard)(servo)
            elif name == "position" and isinstance(value, (int, float)):
                # Turned by hand: it does not want to go back.
                for at in (POSITION_AT, codec.GOAL_POSITION):
                    memory[at : at + 2] = round(value).to_bytes(2, "little")
                self.by_id[servo].leg = Leg(servo, t_ns, float(value), t_ns, float(value))
                self.track.append(self.by_id[servo].leg)
            elif name == "temperature_c" and isinstance(value, int):
                memory[TEMPERATURE_AT] = value
            elif name == "supply_mv" and isinstance(value, int):
                memory[SUPPLY_AT] = value // 100
            else:
                raise ValueError(f"{name} = {value!r} is nothing of this servo's")
