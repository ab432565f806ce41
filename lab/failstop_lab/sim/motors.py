"""The motor handler in the board's firmware, as a model: exactly as permissive, for proofs and the simulated board."""

from __future__ import annotations

from struct import Struct

from failstop.board.rrc.framing import MOTOR, WHEELS, crc8

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

_ID_SPEED = Struct("<Bf")
MOTOR_TYPES = 4


class Motors:
    """Four wheel speeds and what motor commands make of them (firmware source).

    Ids are not checked, the count is not checked against the data, and NaN and infinity are speeds like any other.
    `speeds_rps` holds the set points of wire ids 0 to 3, `kind` the motor type. `wild` holds (id, speed in rps) of
    every write outside the table and of every write made from bytes beyond the data. What the firmware reads there is
    its receive buffer, cleared after every frame: the CRC, then zeros; beyond the buffer anything, here zeros.
    """

    __slots__ = ("kind", "speeds_rps", "wild")

    def __init__(self, speeds_rps: Sequence[float] = (0.0, 0.0, 0.0, 0.0)) -> None:
        self.speeds_rps: list[float] = list(speeds_rps)
        self.wild: list[tuple[int, float]] = []
        self.kind = 0

    def copy(self) -> Motors:
        """Independent motors with the same speeds and the same record of wild writes."""
        other = Motors()
        other.speeds_rps = list(self.speeds_rps)
        other.wild = list(self.wild)
        other.kind = self.kind
        return other

    @property
    def stopped(self) -> bool:
        """Whether all four set points are zero."""
        return not any(self.speeds_rps)

    def execute(self, data: bytes) -> tuple[float, float, float, float]:
        """Carry out the data of one MOTOR frame and return the four speeds (rps) after it."""
        size = len(data)
        crc = crc8(data, crc8((MOTOR, size)))
        # Long enough for the largest count a byte can hold.
        memory = (data + bytes((crc,))).ljust(2 + 255 * _ID_SPEED.size, b"\0")
        command = memory[0]
        if command == 0x00:
            self._write(memory, 1, size)
        elif command == 0x01:
            for index in range(memory[1]):
                self._write(memory, 2 + index * _ID_SPEED.size, size)
        elif command == 0x02:
            self._set(memory[1], 0.0, beyond=size < 2)
        elif command == 0x03:
            for wheel in range(WHEELS):
                if memory[1] >> wheel & 1:
                    self._set(wheel, 0.0, beyond=size < 2)
        elif command == 0x05:
            # Types the firmware does not know become type 0.
            self.kind = memory[1] if memory[1] < MOTOR_TYPES else 0
        a, b, c, d = self.speeds_rps
        return a, b, c, d

    def _write(self, memory: bytes, at: int, size: int) -> None:
        wheel, rps = _ID_SPEED.unpack_from(memory, at)
        self._set(wheel, rps, beyond=at + _ID_SPEED.size > size)

    def _set(self, wheel: int, rps: float, *, beyond: bool) -> None:
        if wheel < WHEELS:
            self.speeds_rps[wheel] = rps
        if beyond or wheel >= WHEELS:
            self.wild.append((wheel, rps))
