"""Serial: a probe of a motor board at its port, by the board's own frames from a throw-away process."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Callable

from failstop import helpers
from failstop.api.errors import FailstopError
from failstop.board import asking
from failstop.board.interface import BY_IMU, HEARD_IMU, HEARD_WHEELS, Board
from failstop.board.kinds import board_of, is_described, is_own, wire_of
from failstop.board.port import PortError, has_lines, open_port
from failstop.board.tap import Tap
from failstop.policy.halted import Halted
from failstop.policy.layouts import BOARDS
from failstop.procs.telemetry.imu import RAD_PER_DEG
from failstop.setup.ending import end_with_parent, uninterrupted
from failstop.setup.halt import Halt
from failstop.supervisor.port_handover import OwnPort
from failstop_lab.probe import judge
from failstop_lab.probe.card import Row
from failstop_lab.probe.watcher import ANSWERS_S, STARTS_S, STOP_WORD, Orders
from failstop_lab.prove import shake
from failstop_lab.prove.sight import SeenSample

PERIOD_S = 0.1
"""Between two frames of the throw-away driver, as vendors' drivers have it."""
RPS = 0.5
TURNS_S = 1.5
MORE_S = 0.5
STILL_S = 2.0
ASK_S = 0.02
TURN_S = 0.002
PLUG_S = 60.0
ROWS = {
    "sigkill": "its driver is killed (SIGKILL)",
    "sigstop": "its driver hangs (SIGSTOP)",
    "close": "its driver closes the port",
    "silence": "its driver falls silent",
    "plug": "the plug is pulled",
}
SIGNALS = {
    "sigkill": signal.SIGKILL,
    "sigstop": signal.SIGSTOP,
    "close": signal.SIGUSR2,
    "silence": signal.SIGUSR1,
}
UNDATED = "the port did not show when the plug was pulled"
CLOSES = ("sigkill", "close")
"""Rows after which nobody of the driver's has the port open: the kernel lowers its modem lines."""


class SerialProbe:
    """A context manager. At its end the watcher stops the wheels and so does this process, whatever happens; `outcome`
    is what is known then."""

    def __init__(self, path: str, kind: str, board: Board, frame: bytes, *, by_key: bool, say: Callable[[str], None]):
        """`frame`: what the driver sends again and again; `by_key`: a person says when the wheels stand."""
        self._path, self._kind, self._board, self._frame = path, kind, board, frame
        self._say = say
        self._by_key = by_key
        self.unjudged = ""
        """Why nobody can judge whether the wheels stop; empty: somebody can."""
        """Why nobody can judge this board's wheels here; empty: somebody can."""
        self._tap: Tap | None = None
        self._samples: list[SeenSample] = []
        self._ask_ns = 0
        self._shaking: judge.Shaking | None = None
        self._driver: subprocess.Popen[str] | None = None
        self._watcher: subprocess.Popen[str] | None = None
        self._orders: Orders | None = None
        self._gone_ns = 0
        self._heard_ns = 0
        """When the board reported or answered anything last."""
        self._halt = Halt(path, board, say)
        own_s = wire_of(kind).watchdog.after_ns / 1e9 if is_described(kind) else 0.0
        self._turns_s = max(TURNS_S, own_s + MORE_S)
        """Before a failure: the stop before may have armed the board's watchdog, which must have acted by then. Else it
        would stop the wheels of a driver whose frames do not feed it."""

    @property
    def by(self) -> str:
        """How rest is judged."""
        if self._by_key:
            return judge.PERSON
        return judge.GYRO if self._board.observed_by == BY_IMU else judge.OWN_WORD

    @property
    def shaking(self) -> judge.Shaking | None:
        """How the IMU tells turning wheels from resting ones; None: the wheels' own reports do."""
        return self._shaking

    @property
    def watcher_pid(self) -> int:
        """The process that stops the wheels when this one is killed."""
        return self._watcher.pid if self._watcher else 0

    def __enter__(self) -> SerialProbe:
        words = helpers.python("failstop_lab.probe.watcher", self._path, self._kind, str(self._board.port.baud))
        self._watcher = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        self._orders = Orders(self._watcher)
        try:
            self._order(STOP_WORD)
            self._open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def outcome(self) -> Halted | None:
        """What is known of the wheels at the end; None: they were never to turn."""
        return self._halt.last

    def close(self) -> None:
        """Stop the wheels, and let everything go. The watcher writes the stop and so does this process, because either
        may hang or die."""
        with uninterrupted():
            self._end_driver()
            self._let_go()
            if self._watcher and self._watcher.stdin:
                with contextlib.suppress(OSError):
                    self._watcher.stdin.close()  # its end is the order to stop
            if os.path.exists(self._path):
                self._end_watcher()
            # A watcher that waits for the port goes on when this process waits no longer.
            if self._halt.now().written:
                self._end_watcher()

    def _end_watcher(self) -> None:
        """Let it write its stop, for a while; then kill it."""
        watcher, self._watcher = self._watcher, None
        if watcher is None:
            return
        try:
            watcher.wait(ANSWERS_S)
        except subprocess.TimeoutExpired:
            watcher.kill()
            watcher.wait()
        if watcher.stdout:
            watcher.stdout.close()

    def _open(self) -> None:
        self._let_go()
        fd = open_port(self._path, exclusive=False, line=self._board.port)
        self._tap = Tap(fd, self._board)
        if has_lines(fd):
            time.sleep(self._board.port.deaf_ns / 1e9)

    def _let_go(self) -> None:
        if self._tap:
            os.close(self._tap.fd)
            self._tap = None

    def _order(self, line: str) -> None:
        """Give the watcher an order."""
        assert self._orders
        self._orders.give(line)

    def look(self) -> None:
        """Take in what the board says. A port that goes away is let go."""
        if self._tap is None:
            return
        now_ns = time.monotonic_ns()
        try:
            # Boards that say nothing of their wheels unasked.
            if self._board.ping_ns and now_ns >= self._ask_ns:
                self._ask_ns = now_ns + int(ASK_S * 1e9)
                with contextlib.suppress(BlockingIOError):
                    self._tap.ping()
            for t_ns, kind, said in self._tap.read():
                self._heard_ns = t_ns
                if kind == HEARD_IMU and self._board.observed_by == BY_IMU:
                    self._samples.append((t_ns, said[3] * RAD_PER_DEG, said[4] * RAD_PER_DEG))
                elif kind == HEARD_WHEELS and self._board.observed_by != BY_IMU:
                    self._samples.append((t_ns, *said))
        except OSError:
            self._gone_ns = time.monotonic_ns()
            self._let_go()

    def _until(self, seconds: float, found: Callable[[], bool] = lambda: False) -> bool:
        until_s = time.monotonic() + seconds
        assert self._orders
        while time.monotonic() < until_s:
            self._orders.here()
            self.look()
            if found():
                return True
            time.sleep(TURN_S)
        return False

    def character(self) -> None:
        """Whether rest and turning can be told apart here; else a person's key is the judge."""
        if self._by_key:
            return
        self._samples.clear()
        self._until(STILL_S)
        still = list(self._samples)
        self._start()
        self._samples.clear()
        self._until(TURNS_S)
        turning = list(self._samples)
        self._finish()
        if self._board.observed_by == BY_IMU:
            noises = shake.noise(still), shake.noise(turning)
            self._shaking = judge.Shaking(noises[0], noises[1]) if noises[0] and noises[1] else None
            tells = self._shaking is not None and self._shaking.distinguishes
        else:
            tells = _ends_at_rest(still) and bool(turning) and not _ends_at_rest(turning)
        if not tells and not judge.somebody():
            self.unjudged = judge.NO_JUDGE
        elif not tells:
            self._say("The board's reports don't show whether its wheels turn, so you will press a key when they stop.")
            self._say(
                "If no wheel has turned, press Ctrl-C: the motors have no power, or the board does not know "
                "these frames."
            )
            self._by_key = True

    def _rest_ns(self) -> int | None:
        if self._board.observed_by == BY_IMU:
            return self._shaking.rest_ns(self._samples) if self._shaking else None
        return judge.rest_ns(self._samples)

    def run_row(self, name: str) -> Row:
        """Make one row, and stop the wheels at its end. Raises FailstopError, OSError."""
        if self.unjudged:
            return Row(name, ROWS[name], unjudged=self.unjudged)
        if name == "plug":
            return self._plug()
        self._gone_ns = 0
        if not self._turn():
            return Row(name, ROWS[name], unjudged=judge.NOT_TURNING)
        assert self._driver
        if self._by_key:
            self._say(judge.PRESS)
            judge.key_pressed()
        self._samples.clear()
        cause_ns = time.monotonic_ns()
        os.kill(self._driver.pid, SIGNALS[name])
        if name in CLOSES:
            self._lower_lines()
        stands_ns = self._stands(cause_ns)
        unseen = not self._by_key and judge.silent(self._samples, time.monotonic_ns())
        self._finish()
        if self._gone_ns:
            raise FailstopError(f"{self._path} disappeared during the test, so nobody saw what the wheels did")
        if stands_ns is None:
            why = judge.NO_REPORTS.format("the board") if unseen else self._asked() if self._by_key else ""
            return Row(name, ROWS[name], None, self.by, cause_ns=cause_ns, unjudged=why)
        seconds, within_s = (stands_ns - cause_ns) / 1e9, 0.0
        if not self._by_key:
            seconds, within_s = judge.dated(self._samples, cause_ns, stands_ns)
        return Row(name, ROWS[name], seconds, self.by, within_s=within_s, cause_ns=cause_ns)

    def _asked(self) -> str:
        """Why nobody knows whether the wheels turned to the end, by the person; empty: they did."""
        return judge.turned_on(self._say, self._until)

    def _stands(self, cause_ns: int) -> int | None:
        """When the wheels came to rest; None: they did not within NEVER_S."""
        pressed_ns = 0

        def stands() -> bool:
            nonlocal pressed_ns
            if self._by_key:
                pressed_ns = time.monotonic_ns() if judge.key_pressed() else 0
                return pressed_ns > 0
            return len(self._samples) > 1 and judge.believed(self._samples, self._rest_ns())

        if not self._until(judge.NEVER_S + (0 if self._by_key else judge.RESTS_S), stands):
            return None
        rest = pressed_ns or self._rest_ns()
        return rest if rest is not None and rest - cause_ns < judge.NEVER_S * 1e9 else None

    def _lower_lines(self) -> None:
        """As the kernel does when the last descriptor of a port is closed; the judge has one open."""
        if self._tap and has_lines(self._tap.fd):
            fcntl.ioctl(self._tap.fd, termios.TIOCMBIC, struct.pack("I", termios.TIOCM_DTR | termios.TIOCM_RTS))

    def _plug(self) -> Row:
        """The person pulls it, and says when the wheels stand: nothing comes through it any more. A port that stays,
        because the plug is pulled at the board's end, shows by the end of the board's reports when that was."""
        self._gone_ns = 0
        if not self._turn():
            return Row("plug", ROWS["plug"], unjudged=judge.NOT_TURNING)
        reports = not self._silent()
        self._say("PULL THE BOARD'S PLUG NOW, then press Enter as soon as the wheels have stopped.")
        judge.key_pressed()
        pressed_ns = 0

        def pulled() -> bool:
            return self._gone_ns > 0 or (reports and self._silent())

        def pulled_or_pressed() -> bool:
            nonlocal pressed_ns
            pressed_ns = time.monotonic_ns() if judge.key_pressed() else 0
            return pressed_ns > 0 or pulled()

        self._until(PLUG_S, pulled_or_pressed)
        if pressed_ns and reports:  # a pulled plug may not have shown yet
            self._until(judge.SILENT_S + MORE_S, pulled)
        if reports and not pulled():
            self._finish()
            return Row("plug", ROWS["plug"], skipped="nobody pulled it")
        cause_ns = self._gone_ns or (self._heard_ns if reports else 0)
        stands_ns: int | None = pressed_ns
        if cause_ns and pressed_ns <= cause_ns:
            by_key, self._by_key = self._by_key, True
            stands_ns = self._stands(cause_ns)
            self._by_key = by_key
        self._end_driver()
        if not self._gone_ns:  # the line may still be whole, and then this stops the wheels now
            with contextlib.suppress(FailstopError):
                self._order(STOP_WORD)
        if not cause_ns:
            self._say("Plug the board in again, then press Enter.")
        elif stands_ns is None:
            self._say(f"No key within {judge.NEVER_S:g} s. Plug the board in again; then the stop is written at once.")
        else:
            self._say("Plug the board in again.")
        self._wait_for_plug(reports=reports)
        self._order(STOP_WORD)
        self._open()
        if not cause_ns:
            return Row("plug", ROWS["plug"], unjudged=UNDATED)
        if stands_ns is None:
            return Row("plug", ROWS["plug"], None, judge.PERSON, cause_ns=cause_ns, unjudged=self._asked())
        return Row("plug", ROWS["plug"], (stands_ns - cause_ns) / 1e9, judge.PERSON, cause_ns=cause_ns)

    def _silent(self) -> bool:
        """Whether the board has not reported or answered anything for a while."""
        return time.monotonic_ns() - self._heard_ns > judge.SILENT_S * judge.NS

    def _wait_for_plug(self, *, reports: bool) -> None:
        """Wait until the board is plugged in again: until its port is there, or it reports. A person says it of one
        that does not report. Raises FailstopError."""
        since_ns = time.monotonic_ns()

        def back() -> bool:
            if self._gone_ns:
                return os.path.exists(self._path)
            return self._heard_ns > since_ns or (not reports and judge.key_pressed())

        if not self._until(PLUG_S, back):
            raise FailstopError("the board was not plugged in again")

    def _turn(self) -> bool:
        """Have the throw-away driver turn the wheels; False: the board reports that they don't, and all is stopped."""
        self._start()
        self._samples.clear()
        self._until(self._turns_s)
        if self._by_key or not judge.rested(self._samples, self._rest_ns()):
            return True
        self._finish()
        return False

    def _start(self) -> None:
        """The throw-away driver drives."""
        line = self._board.port
        words = [self._path, str(line.baud), str(int(line.dtr)), str(int(line.rts)), self._frame.hex(), str(PERIOD_S)]
        self._driver = subprocess.Popen(
            helpers.python("failstop_lab.probe.driver", *words),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=end_with_parent,
        )
        self._order(f"drive {self._driver.pid}")
        told, said = self._driver.stdin, self._driver.stdout
        assert told
        assert said
        # Not before the watcher knows of it: a probe that is killed in between would leave it to drive on.
        told.write("drive\n")
        told.flush()
        if not self._until(STARTS_S, lambda: bool(select.select([said], [], [], 0)[0])):
            raise FailstopError(f"the driver did not start within {STARTS_S:g} s")
        if not said.readline():
            raise FailstopError(f"the driver could not open {self._path}")

    def _finish(self) -> None:
        """Stop the wheels, whatever was done to the driver. Raises FailstopError when no stop could be written."""
        self._order(STOP_WORD)
        self._end_driver()
        if self._tap and has_lines(self._tap.fd):
            self._open()
        self._until(judge.RESTS_S)

    def _end_driver(self) -> None:
        if self._driver:
            self._driver.kill()
            self._driver.wait()
            for pipe in (self._driver.stdin, self._driver.stdout):
                if pipe:
                    with contextlib.suppress(OSError):
                        pipe.close()
            self._driver = None


def check_kind(path: str, kind: str, baud: int = 0) -> str:
    """Ask the board what it is, behind a stop; no wheel turns by that. Returns what there is to doubt. Raises
    FailstopError where another board answers, or this one at another baud rate: frames that it does not know would make
    a card of nothing."""
    boards = {each: board_of(each, 1.0, 0.0, baud=baud * (each == kind)) for each in dict.fromkeys((kind, *BOARDS))}
    try:
        with contextlib.closing(OwnPort.open_and_stop(path, boards[kind])) as own:
            heard = asking.seek(own.fd, boards, time.monotonic_ns(), strangers=is_own(kind))
    except (OSError, PortError) as error:
        raise FailstopError(str(error)) from None
    if heard[-1].known and heard[-1].kind != kind:
        found = heard[-1].kind
        raise FailstopError(f"the board that answers is {found}, not {kind}: give --board {found}, or plug in {kind}")
    if heard[-1].known and heard[-1].other_baud:
        raise FailstopError(f"{kind} answers at {heard[-1].other_baud} baud: give --baud {heard[-1].other_baud}")
    known, text, _ = asking.told_of(heard, kind, boards[kind])
    return "" if known else text


def _ends_at_rest(samples: list[SeenSample]) -> bool:
    """Whether these end in a rest that lasts: of two reports after each other a slow wheel may say the same place."""
    return judge.believed(samples, judge.rest_ns(samples))


def frame_of(board: Board, rps: float = RPS) -> bytes:
    """The board's own frame for slow wheels, all the same way as they are wired."""
    return board.motor_speeds([rps] * board.wheels, rps)
