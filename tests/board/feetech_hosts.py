"""Two foreign hosts of Feetech servos, feetech-servo-sdk and rustypot, on the simulated bus: `make feetech`.

Each frame that they write is compared with failstop's own, and with what the simulated servos keep of it; each answer
of these servos is read by the foreign host and by failstop. `--record FILE` keeps some of it, for `make test`.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import random
import threading
import tty
from importlib.metadata import version
from pathlib import Path
from typing import Any

from failstop.board.feetech import codec
from failstop.board.wire import Battery, Obeyed, Wheels
from failstop_lab.boards.feetech import BYTE_NS, Bus

LONG_NS = 10_000_000
"""Longer than three answers take."""
PRESENT_SPEED, SUPPLY_BYTE = 58, 62
KEPT = 70
WHEELS = list(codec.WHEELS)
Read = tuple[list[int], list[int], list[int]]
"""Of the wheels: goal speeds, speeds, supplies in V / 10."""


class Line:
    """A simulated bus that is given bytes, and what it says to them; the port of the first host."""

    is_using = False

    def __init__(self) -> None:
        self.bus = Bus()
        self.wrote = self.said = b""
        self._now_ns = self._heard = 0

    def take(self, data: bytes) -> bytes:
        """Its answers to these bytes."""
        for value in data:
            self._now_ns += BYTE_NS
            self.bus.byte(self._now_ns, value)
        self._now_ns += LONG_NS
        self.bus.until(self._now_ns)
        answers = b"".join(said for _, said in self.bus.said[self._heard :])
        self._heard = len(self.bus.said)
        return answers

    def clearPort(self) -> None:
        self.said = b""

    def writePort(self, packet: list[int]) -> int:
        self.wrote = bytes(packet)
        self.said = self.take(self.wrote)
        return len(packet)

    def readPort(self, length: int) -> bytes:
        data, self.said = self.said[:length], self.said[length:]
        return data

    def setPacketTimeout(self, _length: int) -> None:
        """Everything is there at once."""

    def isPacketTimeout(self) -> bool:
        return not self.said


class Sdk:
    """feetech-servo-sdk."""

    name = "feetech-servo-sdk"

    def __init__(self) -> None:
        import scservo_sdk  # type: ignore[import-not-found]

        self.line, self._sdk = Line(), scservo_sdk
        self._handler = scservo_sdk.PacketHandler(0)

    def speeds(self, speeds: list[int]) -> bytes:
        """The frame that it writes for these goal speeds."""
        group = self._sdk.GroupSyncWrite(self.line, self._handler, codec.GOAL_SPEED, 2)
        for wheel, speed in zip(WHEELS, speeds, strict=True):
            word = self._sdk.SCS_TOSCS(speed, 15)
            group.addParam(wheel, [self._sdk.SCS_LOBYTE(word), self._sdk.SCS_HIBYTE(word)])
        group.txPacket()
        self.line.is_using = False
        return self.line.wrote

    def read(self, size: int) -> tuple[bytes, bytes, Read]:
        """The question that it writes for so much of each wheel's memory, the answers, and what it reads in them."""
        group = self._sdk.GroupSyncRead(self.line, self._handler, codec.GOAL_SPEED, size)
        for wheel in WHEELS:
            group.addParam(wheel)
        group.txPacket()
        answers = self.line.said
        assert group.rxPacket() == self._sdk.COMM_SUCCESS
        goals, now = (
            [self._sdk.SCS_TOHOST(group.getData(wheel, at, 2), 15) for wheel in WHEELS]
            for at in (codec.GOAL_SPEED, PRESENT_SPEED)
        )
        return self.line.wrote, answers, (goals, now, [group.getData(wheel, SUPPLY_BYTE, 1) for wheel in WHEELS])


class Rustypot:
    """rustypot, whose port is a terminal."""

    name = "rustypot"

    def __init__(self) -> None:
        import rustypot  # type: ignore[import-not-found]

        self.line = Line()
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._host: Any = rustypot.Sts3215PyController(os.ttyname(slave), 1_000_000, 1.0)
        self._seen: queue.Queue[tuple[bytes, bytes]] = queue.Queue()
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        kept = b""
        while True:
            kept += os.read(self._master, 4096)
            while len(kept) > 3 and len(kept) >= kept[3] + 4:
                packet, kept = kept[: kept[3] + 4], kept[kept[3] + 4 :]
                answers = self.line.take(packet)
                self._seen.put((packet, answers))
                if answers:
                    os.write(self._master, answers)

    def speeds(self, speeds: list[int]) -> bytes:
        """As of the first host. Its calls in rad/s saturate: only those of raw values judge."""
        self._host.sync_write_raw_goal_speed(WHEELS, [abs(speed) | (speed < 0) << 15 for speed in speeds])
        return self._seen.get()[0]

    def read(self, size: int) -> tuple[bytes, bytes, Read]:
        """As of the first host."""
        found = [bytes(each) for each in self._host.sync_read_raw_data(WHEELS, codec.GOAL_SPEED, size)]
        packet, answers = self._seen.get()

        def words(at: int) -> list[int]:
            return [int(codec.signed(int.from_bytes(each[at : at + 2], "little"))) for each in found]

        supplies = [each[SUPPLY_BYTE - codec.GOAL_SPEED] for each in found]
        return packet, answers, (words(0), words(PRESENT_SPEED - codec.GOAL_SPEED), supplies)


def random_memory(bus: Bus, rng: random.Random) -> None:
    """Fill what is read of the wheels with anything."""
    for wheel in WHEELS:
        bus.memory[wheel][codec.GOAL_SPEED : codec.GOAL_SPEED + max(codec.SIZES)] = rng.randbytes(max(codec.SIZES))


def held(host: Sdk | Rustypot, frames: int, rng: random.Random) -> list[list[Any]]:
    """Compare so many frames down, and so many answers up; returns them as they are recorded."""
    ours = Line()
    kept: list[list[Any]] = []
    for _ in range(frames):
        speeds = [rng.randint(-int(codec.LIMIT), int(codec.LIMIT)) for _ in WHEELS]
        frame = host.speeds(speeds)
        assert frame == codec.motion(speeds, codec.LIMIT), (host.name, speeds, frame.hex())
        assert codec.speeds(frame) == tuple(speeds)
        assert codec.check_motion(frame, codec.LIMIT) == ""
        ours.take(frame)
        assert host.line.bus.wheels == ours.bus.wheels == tuple(speeds)
        kept.append([frame.hex(), speeds])
    for _ in range(frames):
        random_memory(host.line.bus, rng)
        size = rng.choice(codec.SIZES)
        question, answers, (goals, now, supplies) = host.read(size)
        assert question == codec.QUESTIONS[codec.SIZES.index(size)], (host.name, question.hex())
        wheels, obeyed, _, battery, _ = codec.Replies().feed(answers)
        assert isinstance(wheels, Wheels)
        assert isinstance(obeyed, Obeyed)
        assert isinstance(battery, Battery)
        assert (list(obeyed.speeds), list(wheels.speeds)) == (goals, now), (host.name, answers.hex())
        assert battery.volts == min(supplies) / 10
        kept.append([question.hex(), answers.hex(), goals, now, min(supplies)])
    return kept[:KEPT] + kept[-KEPT:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100_000, help="down, and as many answers up, of each host")
    parser.add_argument("--record", type=Path, help="where to keep some of them")
    arguments = parser.parse_args()
    recorded: dict[str, Any] = {}
    for host in (Sdk(), Rustypot()):
        told = f"{host.name} {version(host.name)}"
        recorded[told] = held(host, arguments.frames, random.Random(told))
        print(f"{told}: {arguments.frames} frames and {arguments.frames} answers, none differs")
    if arguments.record:
        rows = (f"{json.dumps(told)}: [\n{','.join(map(_line, cases))}]" for told, cases in recorded.items())
        arguments.record.write_text("{" + ",\n".join(rows) + "}\n")


def _line(case: list[Any]) -> str:
    return json.dumps(case, separators=(",", ":")) + "\n"


if __name__ == "__main__":
    main()
