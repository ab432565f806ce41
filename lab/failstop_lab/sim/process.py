"""The simulated board as a process: one loop that reads the port, lets the model's time pass and serves the control
socket.

Whatever is read is stamped before anything else is done with it, the port comes before the control socket, and all
formatting and writing comes last. The process asks for SCHED_FIFO above what it judges, so that a busy machine does not
make its times late; without the right to that it goes on, and says so in its info.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import socket
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from failstop_lab.boards.live import board_model
from failstop_lab.sim import upward
from failstop_lab.sim.control import SUFFIX, ControlMessage, ControlServer, Wait
from failstop_lab.sim.model import Frame
from failstop_lab.sim.options import Options
from failstop_lab.sim.pty_port import PtyPort, SimError, check_link
from failstop_lab.sim.recorder import Recorder
from failstop_lab.sim.usb.port import UsbPort

PRIORITY = 60
# In one answer; a frame is at most some 800 bytes of JSON, and a message of more than 200 KB is refused.
EVENTS_PER_ANSWER = 100
# Beyond what anyone waits for, and within what select takes.
_LONGEST_WAIT_S = 3600.0


class Simulator:
    """One board, in the main thread of a process of its own: it takes SIGTERM and SIGINT for requests to end.

    Raises SimError when it cannot be set up; run() serves it until it is told to end, and cleans up.
    """

    def __init__(self, options: Options, *, on_frame: Callable[[Frame], None] | None = None) -> None:
        check_link(options.link)
        self.start_ns = time.monotonic_ns()
        self.scheduling = "not running"
        self._options = options
        self._on_frame = on_frame
        self._ending = False
        self._told = 0
        try:
            self._model = board_model(
                options.board,
                self.start_ns,
                imu_hz=options.imu_hz,
                battery_mv=options.battery_mv,
                seed=options.seed,
                first_invalid=options.first_invalid_func,
                per_rps=options.per_rps,
                motors=options.motors,
            )
        except ValueError as error:
            raise SimError(f"{error}: leave out --motors") from None
        self._requests: dict[str, Callable[[ControlMessage], ControlMessage | Wait]] = {
            "info": self._info,
            "events": self._wait,
            "wheels": self._wheels,
            "joints": self._joints,
        }
        self._epoll = select.epoll()
        with contextlib.ExitStack() as undo:
            undo.callback(self._epoll.close)
            self._wakeup = undo.enter_context(self._woken_by_signals())
            if options.until_eof:
                self._watch_standard_input()
            self._control = ControlServer(self._epoll, options.link + SUFFIX, self._handle, self._events)
            undo.callback(self._control.close)
            self._recorder = Recorder(options.record) if options.record is not None else None
            if self._recorder is not None:
                undo.callback(self._recorder.close)
            # Last: who sees the link finds everything else in place.
            self._port = self._make_port(options)
            undo.callback(self._port.close)
            self._port.plug()
            self._undo = undo.pop_all()

    def _make_port(self, options: Options) -> PtyPort | UsbPort:
        if options.usb:
            return UsbPort(self._epoll, options.link, options.usb)
        return PtyPort(self._epoll, options.link, mode=options.mode, cooked=options.cooked)

    @property
    def node(self) -> str:
        """The terminal that is the port; empty while the kernel has made none."""
        return self._port.node

    def run(self) -> None:
        """Serve until a signal, the request "quit" or, with `until_eof`, the end of standard input."""
        gc.collect()
        gc.freeze()
        gc.disable()
        self.scheduling = _claim_processor()
        with self._undo:
            while not self._ending:
                self._sleep()
                self._serve_descriptors()
                self._report(self._pass_time())

    # The loop.

    def _sleep(self) -> None:
        due_ns = min(self._model.next_ns, self._port.next_ns)
        wait_ns = self._control.next_ns
        if wait_ns is not None and wait_ns < due_ns:
            due_ns = wait_ns
        timeout_s = 0.0 if self._port.more else max(0.0, (due_ns - time.monotonic_ns()) / 1e9)
        # Not epoll's own timeout, which is rounded up to a millisecond.
        select.select((self._epoll,), (), (), min(timeout_s, _LONGEST_WAIT_S))

    def _serve_descriptors(self) -> None:
        port = self._port
        if port.more or port.next_ns <= time.monotonic_ns():
            self._receive()
        ready = self._epoll.poll(0)
        for descriptor, mask in ready:
            if port.owns(descriptor):
                self._receive()
                port.reported(mask)
        for descriptor, _ in ready:
            if descriptor == self._wakeup.fileno():
                self._wakeup.recv(64)
            elif descriptor == 0 and self._options.until_eof:
                self._ending = self._ending or not os.read(0, 4096)
            else:
                self._control.ready(descriptor)

    def _receive(self) -> None:
        for t_ns, chunk in self._port.poll():
            self._model.receive(chunk, t_ns)
            if self._recorder is not None:
                self._recorder.chunk(t_ns, chunk)

    def _pass_time(self) -> int:
        """Returns the time up to which everything has happened."""
        now_ns = time.monotonic_ns()
        for frame in self._model.advance(now_ns):
            self._port.send(frame)
        return now_ns

    def _report(self, now_ns: int) -> None:
        total = self._model.executed_total
        if total > self._told and (self._recorder is not None or self._on_frame is not None):
            for frame in self._model.executed(self._told):
                if self._recorder is not None:
                    self._recorder.frame(frame)
                if self._on_frame is not None:
                    self._on_frame(frame)
        self._told = total
        self._control.answer_waits(total, now_ns)
        if self._recorder is not None:
            self._recorder.write_due(now_ns)

    @contextlib.contextmanager
    def _woken_by_signals(self) -> Iterator[socket.socket]:
        def end(_signal: int, _frame: FrameType | None) -> None:
            self._ending = True

        reader, writer = socket.socketpair()
        with reader, writer:
            reader.setblocking(False)
            writer.setblocking(False)
            self._epoll.register(reader, select.EPOLLIN)
            signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, end)
            try:
                yield reader
            finally:
                signal.set_wakeup_fd(-1)

    def _watch_standard_input(self) -> None:
        try:
            self._epoll.register(0, select.EPOLLIN)
        except OSError:
            raise SimError("--until-eof needs a pipe or a terminal as standard input") from None

    # Requests.

    def _handle(self, request: ControlMessage) -> ControlMessage | Wait:
        operation = str(request.get("op"))
        # So that the answer is about now, and a change holds for what is sent after it. Trying to read makes the
        # kernel pass on what was written before, which the control socket overtakes otherwise.
        self._receive()
        self._pass_time()
        if operation in self._requests:
            return self._requests[operation](request)
        self._change(operation, request)
        if self._recorder is not None:
            self._recorder.fault(time.monotonic_ns(), request)
        return {}

    def _info(self, _request: ControlMessage) -> ControlMessage:
        port = self._port
        return {
            "pid": os.getpid(),
            "start_ns": self.start_ns,
            "scheduling": self.scheduling,
            "link": port.link,
            "node": (port.node or None) if port.plugged else None,
            "opened": port.opened,
            "draining": port.draining,
            "waiting": self._control.waiting,
            "executed": self._model.executed_total,
            "imu_sent": self._model.imu_sent,
            "lost_up_bytes": port.lost_up_bytes,
            **port.info(),
        }

    def _wheels(self, _request: ControlMessage) -> ControlMessage:
        return {"speeds_rps": self._model.wheels, "turned": self._model.turned, "executed": self._model.executed_total}

    def _joints(self, request: ControlMessage) -> ControlMessage:
        servos, now_ns = self._model.servos, time.monotonic_ns()
        begin = int(request.get("since", len(servos.track)))
        legs = servos.track[begin : begin + EVENTS_PER_ANSWER]
        return {
            "t_ns": now_ns,
            "positions": {found.id: found.leg.at(now_ns) for found in servos.by_id.values()},
            "limp": [found.id for found in servos.by_id.values() if found.limp()],
            "track": len(servos.track),
            "legs": [(leg.servo, leg.begin_ns, leg.begin, leg.end_ns, leg.end) for leg in legs],
        }

    def _wait(self, request: ControlMessage) -> ControlMessage | Wait:
        since = int(request["since"])
        timeout_s = float(request.get("timeout_s", 0.0))
        if timeout_s > 0.0:
            if self._model.executed_total > since:
                return self._events(since)
            return Wait(since, time.monotonic_ns() + round(min(timeout_s, _LONGEST_WAIT_S) * 1e9), since)
        settled_ns = self._model.settled_ns
        # Frames that have arrived and are still on the wire belong to the answer.
        return Wait(since, settled_ns, None) if settled_ns is not None else self._events(since)

    def _events(self, since: int) -> ControlMessage:
        frames = self._model.executed(since, EVENTS_PER_ANSWER)
        return {
            "first_kept": self._model.first_kept,
            "executed": self._model.executed_total,
            "events": [(f.index, f.arrival_ns, f.executed_ns, f.func, f.data.hex(), f.speeds, f.wild) for f in frames],
        }

    def _change(self, operation: str, request: ControlMessage) -> None:
        if not (self._change_port(operation, request) or self._change_board(operation, request)):
            raise SimError(f"no such request: {operation}")

    def _change_port(self, operation: str, request: ControlMessage) -> bool:
        port = self._port
        if operation == "unplug":
            port.unplug()
        elif operation == "replug":
            port.plug(request.get("link"))
        elif operation == "stop_draining":
            port.draining = False
        elif operation == "drain":
            port.draining = True
            port.more = True
        elif operation == "keep_speed" and isinstance(port, UsbPort):
            port.device.keeps_speed = _flag(request, "on")
        elif operation == "quit":
            self._ending = True
        else:
            return False
        return True

    def _change_board(self, operation: str, request: ControlMessage) -> bool:
        model = self._model
        now_ns = time.monotonic_ns()
        if operation == "deaf":
            model.deaf = _flag(request, "on")
        elif operation == "silent":
            model.silent = _flag(request, "on")
        elif operation == "garble":
            model.garble_down, model.garble_up = _number(request, "down", 1.0), _number(request, "up", 1.0)
        elif operation == "cut":
            model.cut_bytes = _integer(request, "bytes", 1 << 20)
        elif operation == "restart":
            model.restart(now_ns, round(_number(request, "deaf_s", 60.0) * 1e9))
        elif operation == "refuse_stop":
            model.refuse_stop = _flag(request, "on")
        elif operation == "roll":
            model.roll(float(request["faster"]), float(request["pushed_rps"]))
        elif operation == "disconnect_motor":
            model.disconnect_motor(_flag(request, "on"))
        elif operation == "imu":
            model.imu_on = _flag(request, "on")
        elif operation == "gyro_bias":
            x, y, z = request["rad_s"]
            model.imu.bias_rad_s = (float(x), float(y), float(z))
        elif operation == "battery":
            model.battery_mv = _integer(request, "mv", 65_535)
        elif operation == "key":
            model.key(_integer(request, "id", 255), _integer(request, "event", 255), now_ns)
        elif operation == "pad":
            axes = [int(request.get(axis, 0)) for axis in ("lx", "ly", "rx", "ry")]
            frame = upward.gamepad_frame(_integer(request, "buttons", 0xFFFF), int(request.get("hat", 0)), *axes)
            model.pad(frame, now_ns, hold=bool(request.get("hold", False)))
        elif operation == "servo":
            values = {name: value for name, value in request.items() if name not in ("op", "servo")}
            model.servos.change(_integer(request, "servo", 253), now_ns, **values)
        elif operation == "hand":
            model.turn_by_hand(_integer(request, "wheel", 3), float(request["turns"]))
        elif operation == "pad_silent":
            model.pad_silent()
        else:
            return False
        return True


def _flag(request: ControlMessage, name: str) -> bool:
    value = request[name]
    if not isinstance(value, bool):
        raise TypeError(f"{name} is {value!r}, must be true or false")
    return value


def _integer(request: ControlMessage, name: str, highest: int) -> int:
    value = request[name]
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= highest:
        raise ValueError(f"{name} is {value!r}, must be an integer from 0 to {highest}")
    return value


def _number(request: dict[str, Any], name: str, highest: float) -> float:
    value = float(request[name])
    if not 0.0 <= value <= highest:
        raise ValueError(f"{name} is {value!r}, must be from 0 to {highest:g}")
    return value


def _claim_processor() -> str:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        return f"normal, without SCHED_FIFO: {error.strerror}"
    return f"SCHED_FIFO {PRIORITY}"
