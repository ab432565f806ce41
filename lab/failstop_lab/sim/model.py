"""The controller board as a pure model: bytes and times in, executed frames and upward bytes out.

The model is built to be harder on the host than the board is, never kinder:
- A wheel keeps its last speed forever. The only thing that changes it is an executed motor frame.
- Each byte takes 10 us on the wire and a frame is executed when its last byte has come through, after everything
  that was sent before it. Telemetry takes as long on its own wire.
- What the receiver and the motor handler make of the bytes is in receiver.py and motors.py (firmware source).
All times are CLOCK_MONOTONIC nanoseconds.

- A bus servo's frame is carried out inside the receive task: whatever comes after it, a stop too, waits for the
  servos' own bus (servos.py).

Not modelled: SBUS, and the firmware driving the wheels from a gamepad by itself.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from random import Random

from failstop.board.rrc.codec import PWM_SERVOS
from failstop.board.rrc.framing import BUS_SERVO, MOTOR, PWM_SERVO
from failstop_lab.sim import upward
from failstop_lab.sim.imu import Imu
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import Receiver
from failstop_lab.sim.servos import Servos

Speeds = tuple[float, ...]

BYTE_NS = 10_000
BATTERY_PERIOD_NS = 1_050_000_000
PAD_PERIOD_NS = 50_000_000
# At least this many executed frames are kept, and at most twice as many: half an hour of driving at 50 frames a second
# in 20 MB.
FRAMES_KEPT = 100_000
# A board that was not run for longer than this has lost its telemetry instead of sending it in one heap.
CATCH_UP_NS = 100_000_000
# The firmware averages the battery voltage: a step takes about 3 s to show fully.
BATTERY_READINGS = 3
NEVER_NS = 1 << 63
TRUTH = (1.0, 0.0)
"""What reports say of a speed: so many times it, and so much more."""


class Executed:
    """The command of a frame that the board has executed."""

    __slots__ = ()
    func: int
    data: bytes
    speeds: Speeds

    @property
    def is_motor(self) -> bool:
        """A motor frame of any content."""
        return self.func == MOTOR

    @property
    def is_stop(self) -> bool:
        """A motor frame that tells all wheels to stop, whether or not they do."""
        return commands_stop(self.func, self.data)

    @property
    def is_motion(self) -> bool:
        """A motor frame that sets a wheel to a speed or leaves one turning, and is not a stop."""
        return self.is_motor and not self.is_stop and any(self.speeds)


@dataclass(slots=True)
class Frame(Executed):
    """A frame the board has executed. `speeds` are the wheels' after it, in rps; `wild` are writes that went outside
    the motor table, (id, rps) each; `arrival_ns` is when its last byte was read, `executed_ns` when it took effect."""

    index: int
    arrival_ns: int
    executed_ns: int
    func: int
    data: bytes
    speeds: Speeds
    wild: tuple[tuple[int, float], ...]


def commands_stop(func: int, data: bytes) -> bool:
    """Whether a frame sets all four wheels to zero and does nothing else, whatever they did before."""
    if func != MOTOR:
        return False
    motors = Motors((1.0, 1.0, 1.0, 1.0))
    return not any(motors.execute(data)) and not motors.wild


class BoardModel:
    """The board. Feed it with receive(), let time pass with advance(); `next_ns` says when the latter is due.

    `imu_hz` is the IMU's rate, 0 for a board without one; `first_invalid` as in Receiver. `executed_total` is how many
    frames have been executed, `imu_sent` how many IMU frames went up, `wheels` what the wheels do now (rps). The faults
    below may be set at any time and hold for what comes after.
    """

    def __init__(
        self, start_ns: int, *, imu_hz: float = 110.0, battery_mv: int = 12_000, seed: int = 0, first_invalid: int = 12
    ) -> None:
        self.executed_total = 0
        self.wheels: Speeds = (0.0, 0.0, 0.0, 0.0)
        self.turned: Speeds = ()
        """How far each wheel has been driven, in turns; empty: nobody counts."""
        self.imu = Imu(start_ns, seed)
        self.battery_mv = battery_mv
        self.imu_sent = 0

        # Faults.
        self.deaf = False
        self.silent = False
        self.refuse_stop = False
        self.imu_on = True
        self.garble_down = 0.0
        self.garble_up = 0.0
        self.cut_bytes = 0
        self._lies = TRUTH
        self.prints = True
        """Whether what it prints as it starts can be read, where its kind prints something."""

        self._executed: list[Frame] = []
        self._first_invalid = first_invalid
        self._starts_ns = start_ns
        """Bytes that come before are lost: it is still starting."""
        self._receiver = Receiver(first_invalid)
        self._motors = Motors()
        self._faults = Random(seed + 1)
        self._pending: deque[tuple[int, int, int, bytes]] = deque()
        self._outbox: deque[tuple[int, bytes]] = deque()
        self._down_free_ns = start_ns
        self._up_free_ns = start_ns
        self._imu_period_ns = round(1e9 / imu_hz) if imu_hz else NEVER_NS
        self._imu_ns = start_ns + self._imu_period_ns
        self._battery_readings = deque([battery_mv] * BATTERY_READINGS, maxlen=BATTERY_READINGS)
        self._battery_ns = start_ns + BATTERY_PERIOD_NS
        self._pad_frame = b""
        self._pad_ns = NEVER_NS
        self._pulses = [1500] * PWM_SERVOS
        self._deviations = [0] * PWM_SERVOS
        self.servos = Servos(start_ns, seed)
        self._task_free_ns = start_ns
        """When the receive task has done with the frame that it carries out."""

    def restart(self, t_ns: int, deaf_ns: int) -> None:
        """Its processor begins anew: the wheels are stopped, and for so long it hears and reports nothing."""
        self._receiver = Receiver(self._first_invalid)
        self._motors = Motors()
        self._pending.clear()
        self._outbox.clear()
        self.wheels = (0.0,) * len(self.wheels)
        self._pulses = [1500] * PWM_SERVOS
        self._starts_ns = t_ns + deaf_ns
        self._imu_ns, self._battery_ns = (max(due_ns, self._starts_ns) for due_ns in (self._imu_ns, self._battery_ns))

    # Down: host to board.

    def receive(self, chunk: bytes, t_ns: int) -> None:
        """Take in bytes that were read at t_ns. What they bring about happens in advance()."""
        begin_ns = max(self._down_free_ns, t_ns)
        self._down_free_ns = begin_ns + BYTE_NS * len(chunk)
        if self.deaf or t_ns < self._starts_ns:
            return
        if self.cut_bytes:
            lost = min(self.cut_bytes, len(chunk))
            self.cut_bytes -= lost
            begin_ns += BYTE_NS * lost
            chunk = chunk[lost:]
        if self.garble_down:
            chunk = self._garbled(chunk, self.garble_down)
        for offset, func, data in self._receiver.feed(chunk):
            ready_ns = max(begin_ns + BYTE_NS * (offset + 1), self._task_free_ns)
            self._task_free_ns = ready_ns + (self.servos.holds_ns(data) if func == BUS_SERVO else 0)
            self._pending.append((self._task_free_ns, t_ns, func, data))

    def _execute(self) -> None:
        executed_ns, arrival_ns, func, data = self._pending.popleft()
        wild: tuple[tuple[int, float], ...] = ()
        if func == MOTOR:
            self._set_wheels(self._motors.execute(data))
            if self._motors.wild:
                wild = tuple(self._motors.wild)
                self._motors.wild.clear()
        elif func == PWM_SERVO:
            self._pwm_servo(data, executed_ns)
        elif func == BUS_SERVO and (answer := self.servos.execute(data, executed_ns)):
            self._send(answer, executed_ns)
        self._executed.append(Frame(self.executed_total, arrival_ns, executed_ns, func, data, self.wheels, wild))
        self.executed_total += 1
        if len(self._executed) >= 2 * FRAMES_KEPT:
            del self._executed[:FRAMES_KEPT]

    @property
    def first_kept(self) -> int:
        """The index of the oldest frame that executed() still has."""
        return self.executed_total - len(self._executed)

    @property
    def settled_ns(self) -> int | None:
        """When the last frame that has arrived will have been executed; None when there is none on the wire."""
        return self._pending[-1][0] if self._pending else None

    def executed(self, since: int, limit: int | None = None) -> list[Frame]:
        """The frames executed from index `since` on, the oldest first, up to `limit` of them."""
        begin = max(0, since - self.first_kept)
        return self._executed[begin : None if limit is None else begin + limit]

    def _set_wheels(self, wanted: Speeds) -> None:
        if self.refuse_stop:
            # A zero set point with the PWM held: that wheel turns on.
            wanted = tuple(new or old for new, old in zip(wanted, self.wheels, strict=True))
        self.wheels = wanted

    def disconnect_motor(self, on: bool) -> None:
        """Its last motor hears nothing and says nothing, while the others do. Raises ValueError."""
        raise ValueError("this board's motors have one controller")

    def roll(self, faster: float, pushed_rps: float) -> None:
        """Only boards that report what their wheels do can have one that does something else."""
        raise ValueError("this board does not report its wheels")

    def lie(self, times: float = 1.0, more_rps: float = 0.0) -> None:
        """Its reports say that every wheel turns so many times as fast as it does, and by `more_rps` more. Here the IMU
        shakes as if they did."""
        self._lies = times, more_rps

    @property
    def driven(self) -> Speeds:
        """Speeds that its motors make, in rps; a wheel that somebody pushes turns although they make none."""
        return self.wheels

    def _pwm_servo(self, data: bytes, t_ns: int) -> None:
        command = data[0] if data else 0
        if command == 0x01 and len(data) >= 4:
            for at in range(4, min(4 + 3 * data[3], len(data) - 2), 3):
                self._move_pwm(data[at], data[at + 1] | data[at + 2] << 8)
        elif command == 0x03 and len(data) == 6:
            self._move_pwm(data[3], data[4] | data[5] << 8)
        elif len(data) >= 2 and 1 <= data[1] <= PWM_SERVOS:
            servo = data[1]
            if command == 0x05:
                self._send(upward.pwm_servo_position(servo, self._pulses[servo - 1]), t_ns)
            elif command == 0x07 and len(data) == 3:
                self._deviations[servo - 1] = (data[2] ^ 0x80) - 0x80
            elif command == 0x09:
                self._send(upward.pwm_servo_deviation(servo, self._deviations[servo - 1]), t_ns)

    def _move_pwm(self, servo: int, pulse_us: int) -> None:
        if 1 <= servo <= PWM_SERVOS:
            self._pulses[servo - 1] = pulse_us

    # Up: board to host.

    def pad(self, frame: bytes, t_ns: int, *, hold: bool) -> None:
        """Send one gamepad frame; with `hold`, that frame at 20 Hz until the next call or pad_silent()."""
        self._pad_frame = frame
        self._pad_ns = t_ns + PAD_PERIOD_NS if hold else NEVER_NS
        self._send(frame, t_ns)

    def pad_silent(self) -> None:
        """The pad is unplugged: plain silence."""
        self._pad_ns = NEVER_NS

    def turn_by_hand(self, wheel: int, turns: float) -> None:
        """A person turns a wheel. Raises ValueError."""
        raise ValueError(f"wheel {wheel}, {turns:g} turns: this board counts no turns")

    def key(self, key_id: int, event: int, t_ns: int) -> None:
        """Send one key frame."""
        self._send(upward.key_frame(key_id, event), t_ns)

    def _send(self, frame: bytes, ready_ns: int) -> None:
        self._up_free_ns = max(self._up_free_ns, ready_ns) + BYTE_NS * len(frame)
        if self.garble_up:
            frame = self._garbled(frame, self.garble_up)
        self._outbox.append((self._up_free_ns, frame))

    def _garbled(self, data: bytes, probability: float) -> bytes:
        faults = self._faults
        return bytes(byte ^ 1 << faults.randrange(8) if faults.random() < probability else byte for byte in data)

    def _report_imu(self, now_ns: int) -> None:
        t_ns = self._imu_ns
        self._imu_ns = self._next(t_ns, self._imu_period_ns, now_ns)
        if self.imu_on:
            times, more_rps = self._lies
            seen = tuple([speed * times + more_rps for speed in self.wheels]) if self._lies != TRUTH else self.wheels
            frame = upward.imu_frame(*self.imu.sample(seen, t_ns))
            self.imu_sent += 1
            # The rate is that of complete frames.
            self._send(frame, t_ns - BYTE_NS * len(frame))

    def _report_battery(self, now_ns: int) -> None:
        t_ns = self._battery_ns
        self._battery_ns = self._next(t_ns, BATTERY_PERIOD_NS, now_ns)
        self._battery_readings.append(self.battery_mv)
        self._send(upward.battery(round(sum(self._battery_readings) / BATTERY_READINGS)), t_ns)

    def _report_pad(self, now_ns: int) -> None:
        t_ns = self._pad_ns
        self._pad_ns = self._next(t_ns, PAD_PERIOD_NS, now_ns)
        self._send(self._pad_frame, t_ns)

    @staticmethod
    def _next(t_ns: int, period_ns: int, now_ns: int) -> int:
        following_ns = t_ns + period_ns
        return following_ns if following_ns > now_ns - CATCH_UP_NS else now_ns + period_ns

    # Time.

    @property
    def next_ns(self) -> int:
        """When advance() is next due."""
        due_ns = min(self._imu_ns, self._battery_ns, self._pad_ns)
        if self._pending and self._pending[0][0] < due_ns:
            due_ns = self._pending[0][0]
        if self._outbox and self._outbox[0][0] < due_ns:
            due_ns = self._outbox[0][0]
        return due_ns

    def advance(self, now_ns: int) -> list[bytes]:
        """Let everything happen that is due by now_ns, in the order of its times; return the frames sent up."""
        ready: list[bytes] = []
        while True:
            due_ns = self.next_ns
            if due_ns > now_ns:
                return ready
            if self._outbox and self._outbox[0][0] == due_ns:
                data = self._outbox.popleft()[1]
                if not self.silent:
                    ready.append(data)
            elif self._pending and self._pending[0][0] == due_ns:
                self._execute()
            elif self._imu_ns == due_ns:
                self._report_imu(now_ns)
            elif self._battery_ns == due_ns:
                self._report_battery(now_ns)
            else:
                self._report_pad(now_ns)
