"""SimBoard: a simulated board in a process of its own, for tests, the demo and the bench.

All times are CLOCK_MONOTONIC nanoseconds, so they compare with time.monotonic_ns() in any process.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import IO, Any

from failstop import helpers
from failstop_lab.sim.control import MESSAGE_SIZE, SUFFIX, connect
from failstop_lab.sim.model import Executed, Speeds
from failstop_lab.sim.options import BATTERY_MV, IMU_HZ
from failstop_lab.sim.servos import Leg

START_S = 20.0
SIM_END_S = 5.0
SIM_ANSWER_S = 5.0


class SimBoardError(Exception):
    """The board's process could not be started, is gone, or refused a request."""


@dataclass(frozen=True)
class Event(Executed):
    """A frame the board has executed. At `arrival_ns` its last byte was read from the pty, at `executed_ns` it had come
    through the wire and took effect. `speeds` are the wheels' after it, in rps; `wild` are writes outside the motor
    table, (id, rps) each."""

    index: int
    arrival_ns: int
    executed_ns: int
    func: int
    data: bytes
    speeds: Speeds
    wild: tuple[tuple[int, float], ...] = ()

    def __str__(self) -> str:
        wheels = " ".join(f"{speed:+.3f}" for speed in self.speeds)
        return f"#{self.index} at {self.executed_ns / 1e9:.6f} s: func {self.func} {self.data.hex()}, wheels {wheels}"


class SimBoard:
    """A context manager: the board is there on entry and gone on exit. The port is at `link`."""

    def __init__(
        self,
        link: str | os.PathLike[str],
        *,
        record: str | os.PathLike[str] | None = None,
        imu_hz: float = IMU_HZ,
        battery_mv: int = BATTERY_MV,
        seed: int = 0,
        first_invalid_func: int = 12,
        mode: int | None = None,
        cooked: bool = False,
        usb: str = "",
        board: str = "",
        per_rps: float = 0.0,
        motors: int = 0,
    ) -> None:
        """`board`: its kind; empty: the first. `per_rps`: one turn a second of its wheels in its own unit; 0: as such
        boards usually have it. `motors`: how many it has, where boards of its kind differ; 0: as usual."""
        self.link = os.fspath(link)
        self._control = self.link + SUFFIX
        self._command = helpers.python("failstop_lab.sim", "--until-eof", "--device", self.link)
        self._command += ["--imu-hz", str(imu_hz), "--battery-mv", str(battery_mv), "--seed", str(seed)]
        self._command += ["--first-invalid-func", str(first_invalid_func)]
        self._command += ["--record", os.fspath(record)] if record is not None else []
        self._command += ["--mode", f"{mode:o}"] if mode is not None else []
        self._command += ["--cooked"] if cooked else []
        self._command += ["--usb", usb] if usb else []
        self._command += ["--board", board] if board else []
        self._command += ["--per-rps", str(per_rps)] if per_rps else []
        self._command += ["--motors", str(motors)] if motors else []
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr: IO[bytes] | None = None
        # One connection a thread, so that one may wait while another works.
        self._connections: dict[int, socket.socket] = {}
        self._lock = threading.Lock()
        # The events from index _cursor on that have been fetched and not been returned by events().
        self._cursor = 0
        self._fetched: list[Event] = []

    # The process.

    def __enter__(self) -> SimBoard:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def start(self) -> None:
        """Start the process and return when the link is there. Raises SimBoardError with what it said."""
        if self._process is not None:
            raise SimBoardError(f"the board at {self.link} has been started already")
        # A file and not a pipe: nobody reads it while the board runs.
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115
        # Its standard input ends when this process does, however that comes about, and the board with it.
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._stderr
        )
        stdout = self._process.stdout
        assert stdout is not None
        if not select.select((stdout,), (), (), START_S)[0] or not stdout.readline():
            said = self._said()
            self.close()
            raise SimBoardError(f"no simulated board at {self.link}: {said or f'not ready within {START_S:g} s'}")

    def close(self) -> None:
        """End the process; it removes its link. Nothing if it was never started."""
        for connection in self._connections.values():
            connection.close()
        self._connections.clear()
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            try:
                process.wait(SIM_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                pipe.close()
        if self._stderr is not None:
            self._stderr.close()
            self._stderr = None

    @property
    def pid(self) -> int:
        """The process id. Raises SimBoardError when it was not started."""
        if self._process is None:
            raise SimBoardError(f"the board at {self.link} is not running: start it first")
        return self._process.pid

    def info(self) -> dict[str, Any]:
        """The board's own account: pid, scheduling, link, node (its pty, or None), opened, executed and more."""
        return self._ask("info")

    # Events.

    def events(self, since: int | None = None) -> list[Event]:
        """The frames executed since the last such call, the first time all. With `since`: all from that index on, and
        the next call is not affected. Frames that have arrived and are on the wire are waited for (a few ms)."""
        if since is not None:
            return self._fetch(since)
        with self._lock:
            self._fetched += self._fetch(self._cursor + len(self._fetched))
            found, self._fetched = self._fetched, []
            self._cursor += len(found)
        return found

    def wheels(self) -> Speeds:
        """The wheel speeds now, in rps by wire id."""
        return tuple(self._ask("wheels")["speeds_rps"])

    def turned(self) -> Speeds:
        """How far each wheel has been driven since the start, in turns by wire id; empty: this board does not count."""
        return tuple(self._ask("wheels")["turned"])

    def joints(self) -> dict[int, float]:
        """Where each of the arm's servos stands now, in pulses."""
        return {int(servo): position for servo, position in self._ask("joints")["positions"].items()}

    def joint_legs(self) -> int:
        """How many legs there have been: where a joint_track() from now on begins."""
        found: int = self._ask("joints")["track"]
        return found

    def limp(self) -> list[int]:
        """The servos that hold nothing."""
        found: list[int] = self._ask("joints")["limp"]
        return found

    def joint_track(self, since: int = 0) -> list[Leg]:
        """The acts of the arm's servos, from leg number `since` on, the oldest first."""
        found: list[Leg] = []
        while True:
            answer = self._ask("joints", since=since + len(found))
            found += [Leg(*leg) for leg in answer["legs"]]
            if since + len(found) >= answer["track"]:
                return found

    def servo(self, servo: int, **values: bool | float) -> None:
        """Change a servo: silent, blocked, unloaded, late (each True or False), temperature_c, supply_mv, or its
        position, as by hand."""
        self._ask("servo", servo=servo, **values)

    def wait_for(self, predicate: Callable[[Event], bool], timeout_s: float, since: int | None = None) -> Event:
        """The first event for which `predicate` is true, of those from index `since` on, or of those that events() has
        not returned yet; it returns them still. Raises TimeoutError, with the last events."""
        deadline_s = time.monotonic() + timeout_s
        begin = self._cursor if since is None else since
        index = begin
        last: list[Event] = []
        while True:
            for event in self._from(index, deadline_s - time.monotonic()):
                if predicate(event):
                    return event
                index = event.index + 1
                last = [*last[-4:], event]
            if time.monotonic() >= deadline_s:
                break
        seen = "".join(f"\n  {event}" for event in last)
        raise TimeoutError(f"no such event within {timeout_s:g} s; {index - begin} others from {begin} on{seen}")

    def wait_wheels(self, turning: bool, timeout_s: float) -> Speeds:
        """Wait until any wheel turns, or until all stand; return the speeds (rps). Raises TimeoutError."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            answer = self._ask("wheels")
            speeds = tuple(answer["speeds_rps"])
            if any(speeds) == turning:
                return speeds
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError(f"wheels at {speeds} rps for {timeout_s:g} s, {'none' if turning else 'one'} turns")
            self._ask("events", wait_s=left_s, since=answer["executed"], timeout_s=left_s)

    def _from(self, index: int, timeout_s: float) -> list[Event]:
        """Events from `index` on, after waiting for them if there are none yet."""
        with self._lock:
            kept = self._fetched[max(0, index - self._cursor) :] if index >= self._cursor else []
        if kept:
            return kept
        found = self._answered(self._ask("events", wait_s=timeout_s, since=index, timeout_s=max(timeout_s, 0.0)), index)
        with self._lock:
            if found and found[0].index == self._cursor + len(self._fetched):
                self._fetched += found
        return found

    def _fetch(self, since: int) -> list[Event]:
        found: list[Event] = []
        while True:
            answer = self._ask("events", since=since + len(found))
            found += self._answered(answer, since + len(found))
            if since + len(found) >= answer["executed"]:
                return found

    @staticmethod
    def _answered(answer: dict[str, Any], since: int) -> list[Event]:
        if answer["first_kept"] > since:
            raise SimBoardError(f"the events before {answer['first_kept']} are gone: call events() more often")
        return [
            Event(index, arrival_ns, executed_ns, func, bytes.fromhex(data), tuple(speeds), tuple(map(tuple, wild)))
            for index, arrival_ns, executed_ns, func, data, speeds, wild in answer["events"]
        ]

    # Faults and what people do to the board.

    def unplug(self) -> None:
        """Pull the plug: the link is removed and everyone who has the port open is hung up on. The wheels turn on."""
        self._ask("unplug")

    def replug(self, link: str | os.PathLike[str] | None = None) -> None:
        """Plug in again, as a new pty at the same link or at another, which then is `link`."""
        if link is None:
            self._ask("replug")
        else:
            self._ask("replug", link=os.fspath(link))
            self.link = os.fspath(link)

    def stop_draining(self) -> None:
        """Leave what is written unread, so that the port fills up."""
        self._ask("stop_draining")

    def drain(self) -> None:
        """Read again, beginning with what was left."""
        self._ask("drain")

    def keep_speed(self, on: bool) -> None:
        """On USB: the chip keeps its line coding over a reset of the bus, as one with power of its own may."""
        self._ask("keep_speed", on=on)

    def deaf(self, on: bool) -> None:
        """The receiver drops every byte while telemetry goes on."""
        self._ask("deaf", on=on)

    def silent(self, on: bool) -> None:
        """Nothing that the board says arrives, while it hears and obeys."""
        self._ask("silent", on=on)

    def garble(self, down: float = 0.0, up: float = 0.0) -> None:
        """Flip one bit of a byte with this probability, from the host and to it."""
        self._ask("garble", down=down, up=up)

    def cut(self, count: int) -> None:
        """Lose the next `count` bytes from the host."""
        self._ask("cut", bytes=count)

    def restart(self, deaf_s: float) -> None:
        """Have it start again, as after a dip of its supply: for so long it hears and reports nothing."""
        self._ask("restart", deaf_s=deaf_s)

    def refuse_stop(self, on: bool) -> None:
        """Motor frames are received, but a wheel that is told to stop turns on until this is off and a frame comes."""
        self._ask("refuse_stop", on=on)

    def roll(self, faster: float = 1.0, pushed_rps: float = 0.0) -> None:
        """The first wheel turns so many times as fast as it is told, and by `pushed_rps` more, and the board reports
        it."""
        self._ask("roll", faster=faster, pushed_rps=pushed_rps)

    def disconnect_motor(self, on: bool) -> None:
        """One of its motors hears nothing and says nothing, while the others do."""
        self._ask("disconnect_motor", on=on)

    def turn_by_hand(self, wheel: int, turns: float) -> None:
        """A person turns the wheel of this id."""
        self._ask("hand", wheel=wheel, turns=turns)

    def imu(self, on: bool) -> None:
        """Silence the IMU, or let it report again."""
        self._ask("imu", on=on)

    def gyro_bias(self, x: float, y: float, z: float) -> None:
        """The gyro's constant error, in rad/s."""
        self._ask("gyro_bias", rad_s=(x, y, z))

    def battery(self, mv: int) -> None:
        """The battery's voltage; it takes the board three readings (3 s) to show a step."""
        self._ask("battery", mv=mv)

    def pad(
        self, buttons: int = 0, hat: int = 0, lx: int = 0, ly: int = 0, rx: int = 0, ry: int = 0, *, hold: bool = False
    ) -> None:
        """Send one gamepad frame, as a tap is; with `hold`, send it at 20 Hz until the next pad() or pad_silent()."""
        self._ask("pad", buttons=buttons, hat=hat, lx=lx, ly=ly, rx=rx, ry=ry, hold=hold)

    def pad_silent(self) -> None:
        """The pad is gone: no more frames."""
        self._ask("pad_silent")

    def key(self, key_id: int, event: int) -> None:
        """Send one key event (decoder.KEY_EVENTS)."""
        self._ask("key", id=key_id, event=event)

    # The control socket.

    def _ask(self, operation: str, *, wait_s: float = 0.0, **fields: Any) -> dict[str, Any]:
        try:
            connection = self._connection()
            connection.settimeout(max(wait_s, 0.0) + SIM_ANSWER_S)
            connection.send(json.dumps({"op": operation, **fields}).encode())
            message = connection.recv(MESSAGE_SIZE)
        except OSError as error:
            self._hang_up()
            raise SimBoardError(
                f"the simulated board at {self.link} does not answer: {error}; {self._fate()}"
            ) from None
        except BaseException:
            # An answer that was not waited for must not be taken for that of the next request.
            self._hang_up()
            raise
        if not message:
            self._hang_up()
            raise SimBoardError(f"the simulated board at {self.link} has gone; {self._fate()}")
        answer: dict[str, Any] = json.loads(message)
        if "error" in answer:
            raise SimBoardError(f"the simulated board refused {operation}: {answer['error']}")
        return answer

    def _connection(self) -> socket.socket:
        thread = threading.get_ident()
        connection = self._connections.get(thread)
        if connection is None:
            connection = self._connections[thread] = connect(self._control, SIM_ANSWER_S)
        return connection

    def _hang_up(self) -> None:
        connection = self._connections.pop(threading.get_ident(), None)
        if connection is not None:
            connection.close()

    def _fate(self) -> str:
        if self._process is None:
            return "it is not running: start it first"
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(0.2)
        said = self._said()
        return f"exit code {self._process.returncode}" + (f": {said}" if said else "")

    def _said(self) -> str:
        if self._stderr is None:
            return ""
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(0.2)
        self._stderr.seek(0)
        return self._stderr.read().decode(errors="replace").strip()
