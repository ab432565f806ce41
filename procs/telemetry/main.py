"""Telemetry's loop: reads the board's bytes, decodes them and publishes the values. If a stop button or the stop key is
pressed, telemetry makes the port owner stop the robot. The gamepad's sticks and its reset become requests to the
gate."""

from __future__ import annotations

import os
from math import nan
from time import monotonic_ns, time

import msgpack

from failstop.board import interface
from failstop.files.root import state_directory
from failstop.messages import box, records
from failstop.messages.packing import NO_FIELDS, Fields, Note, pack
from failstop.policy import causes, servos
from failstop.policy.causes import Cause
from failstop.policy.layouts import WHEEL_NAMES
from failstop.policy.processes import HANG_NS
from failstop.policy.settings import mounted_wheels
from failstop.procs.context import Context
from failstop.procs.loop import Loop
from failstop.procs.telemetry import battery, imu
from failstop.procs.telemetry.battery import BatteryLog, Charger, LowBattery
from failstop.procs.telemetry.imu import Accelerometer, GyroBias
from failstop.procs.telemetry.odd import OddReports
from failstop.procs.telemetry.odometry import Odometry
from failstop.procs.telemetry.pad import PRESSES, STANDSTILL, Pad, Tones
from failstop.procs.telemetry.port import HeardPort
from failstop.procs.telemetry.proving import Proving
from failstop.procs.telemetry.readback import ReadBack
from failstop.procs.telemetry.restarts import Restarts
from failstop.procs.telemetry.runaway import NOT_COUNTED, RAN_AWAY, Finding, RunawayJudge, limits_of
from failstop.procs.telemetry.scale import ScaleJudge
from failstop.procs.telemetry.silence import Silence
from failstop.procs.telemetry.state_files import StateFiles
from failstop.procs.telemetry.still import StillJudge
from failstop.procs.telemetry.unasked import Unasked
from failstop.procs.telemetry.wheels import THEY_TURN, Measured, Way, WheelFact, of_every_wheel
from failstop.shm.cell import LatestReader
from failstop.shm.segment import Segment
from failstop.shm.words import Barrier

LONGEST_IDLE_NS = 50_000_000
"""The longest sleep of telemetry, in ns. While the robot is at rest, bytes from the board don't wake telemetry, so it
reads them this often."""
ODOMETRY_NS = 20_000_000
"""How often odometry is published, in ns. The state of the wheels and the comparison of the speeds are never published
more often, and always right after odometry."""
SCALE_NS = 500_000_000
"""How often the comparison of measured and commanded speeds is published while it does not change, in ns."""
TURN_RATE_NS = 200_000_000
"""How long a turn rate of the gyro may be compared with the commanded one, in ns. An IMU that has fallen silent would
otherwise go on turning at its last rate."""
BIAS_NS = 80_000_000
"""How often the gyro's bias is published, in ns. It must come at 10 Hz or faster. But it is published only when
something else wakes telemetry, so with a value of 100 ms it would come every 105 to 110 ms. The state of the wheels is
published as often as the bias, and also with the next odometry after a report about the wheels."""
BATTERY_LOG = "battery log"


class GateState:
    """The commanded motion, whether motion is enabled, and whether a stop is latched, as the gate has published them.
    Before the gate has published anything, zero is commanded, motion is disabled, and no stop is latched."""

    def __init__(self, reader: LatestReader) -> None:
        self._reader = reader
        self._found: object = None
        self._seq = self._t_ns = 0
        self.enabled = False
        self.latched = False
        self.epoch = 0
        """The epoch. Every stop raises it, so telemetry notices a stop that was latched and reset between two looks."""
        self.tucks = False
        """True if the arm has announced that it will move to its tuck pose."""
        self.velocity = STANDSTILL
        """The commanded velocity: m/s forward, m/s left, rad/s counter-clockwise."""
        self.since_ns = 0
        """The time when the gate published this state, or when telemetry noticed that the gate is silent."""
        self.zero_ns = 0
        """The time since which zero has been commanded. 0 if another velocity is commanded, or if nothing was published
        yet."""
        self.wheels_rps: tuple[float, ...] = ()
        """The commanded turns per second of each wheel, by wire id."""

    @property
    def commanded(self) -> bool:
        return any(self.velocity)

    def read(self, now_ns: int) -> bool:
        """Read the gate's state. Returns True if it is new. If the gate has been silent for more than HANG_NS, the
        state becomes: motion is disabled, and nothing is commanded. This counts as a new state too."""
        entry = self._reader.read()
        news = False
        if entry and entry[0] != self._seq:
            self._seq, self._t_ns = entry[0], entry[1]
            news = self._unpack(entry[2], entry[1])
        if now_ns - self._t_ns > HANG_NS and (self.enabled or self.commanded):  # due every 100 ms
            self.enabled = False
            self.velocity = STANDSTILL
            self.since_ns = now_ns
            self.zero_ns = self.zero_ns or now_ns
            news = True
        return news

    def _unpack(self, payload: bytes, t_ns: int) -> bool:
        try:
            # Keep this object until the next state. Its keys are interned strings. If they were dropped and interned
            # again at each turn, Python would have to rebuild its table of interned strings every few minutes.
            found = self._found = msgpack.unpackb(payload)
            vx, vy, wz = found["body_vel"]
            velocity = float(vx), float(vy), float(wz)
            wheels_rps = tuple(map(float, found["wheels_rps"]))
            enabled, latched, epoch = bool(found["enabled"]), found["estop"] is not None, int(found["epoch"])
            self.tucks = bool(found["arm"]["tucks"]) if "arm" in found else False
        except (ValueError, KeyError, TypeError):
            return False
        self.enabled, self.latched, self.epoch, self.velocity, self.since_ns = enabled, latched, epoch, velocity, t_ns
        self.zero_ns = 0 if any(velocity) else self.zero_ns or t_ns
        self.wheels_rps = wheels_rps
        return True


class Telemetry:
    """Telemetry. Call turn() once per wake-up."""

    def __init__(self, context: Context) -> None:
        settings = context.settings
        self.heartbeat = context.heartbeat
        self.loop = Loop()
        self._board = context.board
        self._hearing = self._board.hearing()
        self._settings = settings
        self._servos_told: dict[str, str] = {}
        """For each part that reports an error, the last text about it that was logged."""
        self._wheel_missing = ""
        self._stop_key = int(settings["key.stop"])
        self._pad = Pad(settings)
        self._pad_mode = records.PAD_MODES[self._pad.mode]
        self._pad_sample = (0,) * 6
        """The buttons, the hat and the sticks in the gamepad's last frame."""
        self._tones = Tones(on=settings.on("buzzer.tones"))
        self._accelerometer = Accelerometer(settings)
        self._gyro = GyroBias(settings)
        self._odometry = Odometry(settings)
        self._still = StillJudge(settings["still.std_radps"])
        folder = state_directory(context.instance, os.environ, settings.text("battery.directory"))
        self._files = StateFiles(folder)
        self._low_battery = LowBattery(settings)
        self._charger = Charger(settings)
        self._log = BatteryLog(settings)
        self._read_back = ReadBack(self._board.reports.apart_ns)
        self._uncounted: tuple[float, ...] = ()
        """The turns of the wheels when one of them was found not to be counted, until a count changes. Otherwise
        empty."""
        self._measured = Measured(self._board.reports, self._board.most_rps)
        coarse = self._board.reports.own_scale and self._board.reports.apart_ns > 0
        self._each = Measured(self._board.reports, self._board.most_rps, summed=True) if coarse else self._measured
        """The same with a speed from every report, for the scale, which sums the speeds up."""
        self._fact = WheelFact(settings.ns("still.after_s"))
        self._way = Way(self._board.reports)
        self._unasked = Unasked(settings.ns("still.after_s"))
        mounted = mounted_wheels(settings.values)
        limits = limits_of(settings, self._board)
        self._runaway = RunawayJudge(limits, [wheel for wheel, _ in mounted]) if limits else None
        self._named = {
            wheel: (name, sign) for (wheel, sign), name in zip(mounted, WHEEL_NAMES[len(mounted)], strict=True)
        }
        self._began_ns = monotonic_ns()
        self._proving = Proving(context)
        self._barrier = Barrier()
        self._epoch_followed = self._odometry_ns = self._bias_ns = self._wheels_ns = self._reading_ns = 0
        self._heard: list[tuple[int, interface.Value, int]] = []
        """Reports of the board that are not handled yet, as (kind, value, when it came)."""
        self._bias_flags = (False, False)
        self._silence = Silence(self._board, context.own.word("patience_ns").get())
        self._scale, self._scale_ns = ScaleJudge(settings, self._board), 0
        self._scale_noted: set[str] = set()
        """The levels (`warning`, `info`) for which a difference of the speeds was logged already."""
        self._turn_radps, self._turn_ns = 0.0, 0
        self._odd = OddReports(low_battery_stops=self._low_battery.stops)
        self._attach(context)
        self._watch_others(context)
        self._publish_still(self._still, was_still=False)
        self._inherit(context.own)
        now_ns = monotonic_ns()
        self._gate.read(now_ns)
        self._follow_gate(now_ns)

    def _attach(self, context: Context) -> None:
        """Create the writers of telemetry's records, and the bells that it rings."""
        own = context.own
        latest = ("imu", "bias", "odometry", "wheels", "scale", "battery", "health", "pad", "pad_command", "pad_arm")
        self._latest = {name: own.latest_writer(name) for name in latest}
        rings = ("causes", "pad_requests", "notes", "servos")
        self._rings = {name: own.ring_writer(name) for name in rings}
        self._box = own.ring_writer("box")
        self._still_word = own.word("still_ns")
        self._judged_word = own.word("judged_ns")
        self._said_word, self._patience_word = own.word("said_ns"), own.word("patience_ns")
        self._port_owner_bell = context.bell("port_owner_bell")
        self._gate_bell = context.bell("gate_bell")
        self.supervisor_bell = context.bell("supervisor_bell")

    def _watch_others(self, context: Context) -> None:
        """Open other processes' records, choose a handler for each kind of report, and watch everything that wakes
        telemetry."""
        gate = context.segment("gate")
        self._epoch_word = context.segment("supervisor").word("epoch")
        self._busy_word = gate.word("busy")
        self._restarts = Restarts(context, lambda: self._gate.enabled, self._note, self._raise)
        self._gate = GateState(gate.latest_reader("state"))
        self._handlers = {
            interface.HEARD_IMU: self._on_imu,
            interface.HEARD_BATTERY: self._on_battery,
            interface.HEARD_PAD: self._on_pad,
            interface.HEARD_KEY: self._on_key,
            interface.HEARD_PONG: self._proving.answered,
            interface.HEARD_WHEELS: self._on_wheels,
            interface.HEARD_OBEYED: self._on_obeyed,
            interface.HEARD_SERVO: self._on_servo,
            interface.HEARD_HEALTH: self._on_health,
            interface.HEARD_ODD: self._on_odd,
            interface.HEARD_RESTARTED: self._restarts.started,
        }
        self.loop.listen(context.bell("bell"))
        self._port = HeardPort(context, self.loop, monotonic_ns())

    def _inherit(self, own: Segment) -> None:
        """Continue with the charger's state, the bias and the pose of the previous telemetry process. The charger's
        state is not kept longer, because nobody sees a charger that is plugged in or out while no service runs. The
        gamepad does not continue: it is locked, and published as locked."""
        if own.latest_reader("pad").read():
            self._publish_pad(monotonic_ns())
        if entry := own.latest_reader("battery").read():
            _, self._charger.state = records.BATTERY.unpack(entry[2])
        if entry := own.latest_reader("bias").read():
            x, y, z, _, calibrated = records.BIAS.unpack(entry[2])
            if calibrated:
                self._gyro.inherit((x, y, z))
        if entry := own.latest_reader("odometry").read():
            x_m, y_m, th_rad, *_, source, xx, xy, xt, yy, yt, tt = records.ODOMETRY.unpack(entry[2])
            self._inherit_wheels(own, entry[1])
            self._odometry.inherit(x_m, y_m, th_rad, source, (xx, xy, xt, yy, yt, tt), self._measured)

    def _inherit_wheels(self, own: Segment, read_ns: int) -> None:
        """Continue from the turns that the previous telemetry process has published. Turns made between that record and
        the first new report stay unknown."""
        if entry := own.latest_reader("wheels").read():
            _, _, _, count, _, _, *values = records.WHEELS_SEEN.unpack(entry[2])
            speeds, turns = values[:count], values[records.MOST_WHEELS :][:count]
            if all(value == value for value in (*speeds, *turns)):  # false for NaN, which means not reported
                self._measured.inherit(turns, speeds, read_ns)

    def turn(self, ready: dict[int, int]) -> None:
        """Handle one wake-up. IMU samples are published at once. If only IMU samples have come, the rest of the turn
        waits until odometry is due."""
        now_ns = monotonic_ns()
        whole = len(ready) != 1 or self._port.fd not in ready
        kinds: list[int] = []
        for came_ns, data in self._port.poll(now_ns):
            found = self._hearing.feed(data)
            # Samples that came together count as spread over the longest possible time.
            step_ns = self._port.waited_ns // (len(found) or 1)
            self._silence.heard([kind for kind, _ in found], came_ns)
            for at, (kind, said) in enumerate(found, 1 - len(found)):
                t_ns = came_ns
                kinds.append(kind)
                if kind == interface.HEARD_IMU:
                    t_ns += at * step_ns
                    said = self._publish_imu(said, t_ns)
                else:
                    whole = True
                self._heard.append((kind, said, t_ns))
        self._restarts.heard(kinds, now_ns)
        if whole or self._port.lost or now_ns - self._odometry_ns >= ODOMETRY_NS:
            self._act(ready, now_ns)

    def _act(self, ready: dict[int, int], now_ns: int) -> None:
        """Do the rest of a turn: handle all reports, and publish everything else."""
        if self._gate.read(now_ns):
            self._follow_gate(now_ns)
        if self._runaway:
            gate = self._gate
            self._runaway.follow(gate.wheels_rps, gate.since_ns, now_ns, enabled=gate.enabled and not gate.latched)
        heard, self._heard = self._heard, []
        for kind, said, came_ns in heard:
            if handler := self._handlers.get(kind):
                handler(said, came_ns)
        self._follow_port(ready)
        self._port.rest(now_ns, self._epoch_word.get(), busy=self._busy_word.get() > 0)
        sound = self._tones.sound_for(self._gate.latched, self._pad.mode, tucks=self._gate.tucks)
        if sound and (frame := self._board.buzzer(*sound)):
            self._request(records.PAD_FRAME, frame)
        self._publish(now_ns)
        self._publish_said()
        self._report_pad_mode(now_ns)
        for text, step in self._files.notes():
            self._note("disk", text, step=step)
        self.heartbeat.beat(now_ns)

    def _follow_gate(self, now_ns: int) -> None:
        """Pass the gate's state on to all parts that depend on it."""
        gate = self._gate
        self._odometry.follow(gate.velocity, gate.since_ns or now_ns)
        self._note_gyro(self._gyro.follow(gate.commanded, now_ns))
        self._charger.follow(gate.enabled, now_ns)
        if gate.epoch != self._epoch_followed:
            self._epoch_followed = gate.epoch
            self._pad.stopped(now_ns)
        self._pad.follow(gate.latched, now_ns)

    def _follow_port(self, ready: dict[int, int]) -> None:
        """Wake the port owner if the port is lost. It would not notice the loss, because it does not read the port
        while telemetry runs. After a new descriptor was adopted, forget what was read from the old one, even half
        a frame."""
        if self._port.lost:
            self._port_owner_bell.ring()
        if self._port.held.follow(ready, lost=self._port.lost):
            self._hearing.reset()
            self._restarts.forget()
            self._silence.forget()

    def _publish_said(self) -> None:
        """Publish the time when the board last sent bytes, and how long it may pause. Call this last, after everything
        that was decoded from these bytes was published."""
        silence = self._silence
        if silence.said_ns and silence.said_ns != self._said_word.get():
            self._barrier()
            self._said_word.set(silence.said_ns)
        if silence.patience_ns != self._patience_word.get():
            self._patience_word.set(silence.patience_ns)

    def _publish(self, now_ns: int) -> None:
        """Publish the records that are not published directly when a report of the board comes."""
        if now_ns - self._odometry_ns >= ODOMETRY_NS:
            # Count from the time when it was due. Otherwise, with IMU samples 9 ms apart, odometry would be published
            # with every third sample, at 37 Hz.
            self._odometry_ns = max(self._odometry_ns + ODOMETRY_NS, now_ns - ODOMETRY_NS // 2)
            self._odometry.advance(now_ns)
            found = self._odometry
            pose = (found.x_m, found.y_m, found.th_rad)
            twist = (found.vx_mps, found.vy_mps, found.wz_radps)
            known = (*pose, *twist, *found.twist_std, found.source, *found.covariance)
            self._latest["odometry"].write(records.ODOMETRY.pack(*known), found.t_ns)
            if self._measured.t_ns != self._reading_ns or now_ns - self._wheels_ns >= BIAS_NS:
                self._reading_ns, self._wheels_ns = self._measured.t_ns, now_ns
                self._publish_wheels(now_ns)
                self._compare_speeds(now_ns)
        self._proving.forget(now_ns)
        gyro = self._gyro
        flags = (gyro.tracking, gyro.calibrated)
        if now_ns - self._bias_ns >= BIAS_NS or flags != self._bias_flags:
            self._bias_ns = now_ns
            self._bias_flags = flags
            self._latest["bias"].write(records.BIAS.pack(*gyro.bias_radps, *flags), now_ns)

    def _note(self, kind: str, text: str, fields: Fields = NO_FIELDS, *, level: str = "", step: str = "") -> None:
        """Send a note for people to the supervisor, which logs it as an event."""
        self._pass_on(Note(kind, text, fields, level, step))

    def _pass_on(self, note: Note) -> None:
        self._rings["notes"].put(note.pack())
        self.supervisor_bell.ring()

    def _note_gyro(self, text: str) -> None:
        if text:
            level, step = ("", "") if self._gyro.stationary else ("warning", imu.LEAVE_STANDING)
            self._note("gyro", text, level=level, step=step)

    def _report_pad_mode(self, now_ns: int) -> None:
        """Log and publish the gamepad's mode if it has changed. A stop changes it without a frame of the gamepad."""
        mode = records.PAD_MODES[self._pad.mode]
        if mode != self._pad_mode:
            self._pad_mode = mode
            self._publish_pad(now_ns)
            self._note("pad", f"gamepad mode: {mode}", {"mode": mode})

    def _publish_pad(self, t_ns: int) -> None:
        self._latest["pad"].write(records.PAD.pack(*self._pad_sample, self._pad.mode), t_ns)

    def _request(self, kind: int, frame: bytes = b"") -> None:
        self._rings["pad_requests"].put(records.PAD_REQUEST.pack(kind, frame))
        self._gate_bell.ring()

    def _raise(self, cause: Cause | None) -> None:
        """If there is a cause, make the port owner stop the robot at once. The stop pipe is not used for this, because
        anyone can write to it, so its texts are only claims."""
        if cause:
            self._rings["causes"].put(cause.pack())
            self._port_owner_bell.ring()

    def _publish_imu(self, sample: interface.Value, t_ns: int) -> interface.Value:
        """Publish a sample of the IMU. Returns the raw turn rates and the published values."""
        raw_radps = imu.radps(*sample[3:])
        found = (*self._accelerometer.mps2(*sample[:3]), *self._gyro.corrected(raw_radps))
        self._latest["imu"].write(records.IMU.pack(*found), t_ns)
        return raw_radps, found

    def _on_imu(self, sample: interface.Value, t_ns: int) -> None:
        raw_radps, found = sample
        self._turn_radps, self._turn_ns = found[5], t_ns
        note = self._gyro.add(raw_radps, t_ns)
        self._box.put(box.pack_board(box.IMU_KIND, *map(box.single, found)), t_ns)
        if not self._read_back.judged_ns:
            was_still = self._still.still_ns > 0
            self._still.add(raw_radps[0], raw_radps[1], t_ns)
            self._publish_still(self._still, was_still=was_still)
        self._note_gyro(note)

    def _publish_still(self, judge: StillJudge | ReadBack, *, was_still: bool) -> None:
        # Readers read these words in the opposite order. So nobody sees a new time with an older verdict or with none.
        if not judge.judged_ns:
            self._judged_word.set(0)
            self._barrier()
        self._still_word.set(judge.still_ns)
        self._barrier()
        self._judged_word.set(judge.judged_ns)
        if was_still != (judge.still_ns > 0):
            self.supervisor_bell.ring()

    def _on_wheels(self, sample: interface.Value, t_ns: int) -> None:
        """Handle a report about the wheels. While these reports show whether the wheels turn, the IMU is not used to
        judge that."""
        was_still = self._read_back.still_ns > 0
        speeds, positions = sample
        is_new = self._measured.add(speeds, positions, t_ns)
        if self._each is not self._measured:
            self._each.add(speeds, positions, t_ns)
        self._odometry.roll(self._measured)
        if is_new:
            measured = map(box.single, of_every_wheel(self._measured.speeds_rps))
            self._box.put(box.pack_board(box.WHEELS_KIND, *measured), t_ns)
        self._restarts.counted(positions, t_ns)
        if self._runaway and (found := self._runaway.add(self._measured.speeds_rps, self._measured.turns, t_ns)):
            self._on_finding(found)
        if self._uncounted and self._uncounted != self._measured.turns:
            self._uncounted = ()
        # Counts that stay as they are prove nothing about wheels that are not counted.
        if self._read_back.add((nan,) if self._uncounted else speeds, positions, t_ns):
            self._publish_still(self._read_back, was_still=was_still)

    def _on_finding(self, found: Finding) -> None:
        """Stop if a wheel has run away. If a wheel does not turn although it should, only log it."""
        name, sign = self._named[found.wheel]
        told, seen = round(sign * found.told_rps, 2) + 0.0, round(sign * found.seen_rps, 2) + 0.0
        if found.what == RAN_AWAY:
            self._raise(causes.RUNAWAY(name, told, seen))
        elif found.what == NOT_COUNTED:
            self._uncounted = self._measured.turns
            self._raise(causes.UNCOUNTED(name, told))
        else:
            slow = ", or board.per_rps is far too small" if self._board.reports.own_scale else ""
            told_text = f"the {name} wheel does not turn although the command is {told:.2f} turns a second"
            text = f"{told_text}: it is stalled or unplugged{slow}"
            self._note("wheel_stands", text, {"wheel": name, "told": told, "seen": seen})

    def _publish_wheels(self, now_ns: int) -> None:
        """Publish whether the wheels turn, and their measured speeds and turns. Also react if they turn although zero
        is commanded."""
        fact, measured = self._fact, self._measured
        told_zero_ns = 0 if self._gate.commanded else self._gate.zero_ns or self._began_ns
        went = self._way.went(measured.turns, rest=fact.does != THEY_TURN)
        fact.update(self._read_back, self._still, told_zero_ns, now_ns, went=went)
        self._act_unasked(now_ns)
        speeds, turns = of_every_wheel(measured.speeds_rps), of_every_wheel(measured.turns)
        count = max(len(measured.speeds_rps), len(measured.turns))
        flags = (fact.does, fact.by, fact.unexpected, count)
        self._latest["wheels"].write(
            records.WHEELS_SEEN.pack(*flags, fact.since_ns, fact.read_ns, *speeds, *turns), now_ns
        )

    def _act_unasked(self, now_ns: int) -> None:
        """If the wheels turn although zero is commanded, stop, repeat the last stop, or add a note, as `_unasked`
        decides."""
        gate = self._gate
        act = self._unasked.update(
            self._fact, now_ns, enabled=gate.enabled, latched=gate.latched, epoch=self._epoch_word.get()
        )
        self._raise(act.cause)
        if act.again:
            self._rings["causes"].put(b"")
            self._port_owner_bell.ring()
        if act.note:
            self._pass_on(act.note)

    def _compare_speeds(self, now_ns: int) -> None:
        """Compare the measured speeds with the commanded ones. A difference is logged only once for each level
        (warning, info)."""
        measured, judge = self._each, self._scale
        turns = self._gyro.calibrated and now_ns - self._turn_ns <= TURN_RATE_NS
        turn_radps = self._turn_radps if turns else None
        changed = judge.update(self._gate.velocity, measured.speeds_rps, measured.t_ns, turn_radps, now_ns)
        if changed or now_ns - self._scale_ns >= SCALE_NS:
            self._scale_ns = now_ns
            self._latest["scale"].write(pack([judge.wheels, judge.turn, judge.wrong, judge.remarks]), now_ns)
        for level, texts in (("warning", judge.wrong), ("info", judge.remarks)):
            if texts and level not in self._scale_noted:
                self._scale_noted.add(level)
                for text in texts:
                    self._note("scale", text, level=level)

    def _on_obeyed(self, speeds: interface.Value, t_ns: int) -> None:
        self._proving.obeyed(speeds, t_ns, moves=self._gate.enabled and self._gate.commanded)
        if speeds and not self._proving.faded_ns:  # otherwise its watchdog has acted, so it has not restarted
            self._restarts.obeyed(zeros=not any(speeds))

    def _on_battery(self, sample: interface.Value, t_ns: int) -> None:
        (millivolts,) = sample
        if not millivolts:
            # The board reports no battery. Its voltage is neither low nor changed by a charger, and readers get None.
            self._latest["battery"].write(records.BATTERY.pack(0, self._charger.state), t_ns)
            return
        self._raise(self._low_battery.add(millivolts, t_ns))
        if self._charger.add(millivolts, t_ns):
            name = records.PLUGGED[self._charger.state]
            text = f"charger {name}: the battery's voltage jumped to {millivolts} mV"
            self._note("charger", text, {"state": name, "battery_mv": millivolts})
        self._latest["battery"].write(records.BATTERY.pack(millivolts, self._charger.state), t_ns)
        self._box.put(box.pack_board(box.BATTERY_KIND, millivolts, self._charger.state), t_ns)
        if due := self._log.add(millivolts, self._gate.enabled, t_ns, time()):
            self._files.append(BATTERY_LOG, due[0], battery.HEADER, due[1])

    def _on_pad(self, said: interface.Value, t_ns: int) -> None:
        buttons, hat, lx, ly, rx, ry, data = said
        sample = (buttons, hat, lx, ly, rx, ry)
        news = self._pad.add(sample, data, t_ns)
        self._raise(news.cause)
        if news.command:
            self._latest["pad_command"].write(records.PAD_COMMAND.pack(*news.command), t_ns)
            self._gate_bell.ring()
        if news.arm:
            self._latest["pad_arm"].write(records.PAD_ARM.pack(*news.arm), t_ns)
            self._gate_bell.ring()
        if news.frozen:
            self._note("pad", f"gamepad locked: a stick is pushed and {self._pad.frozen}, so it may be out of reach")
        if news.reset:
            self._request(records.PAD_RESET)
            self._note("pad", "gamepad: MODE was held, reset requested")
        self._pad_sample = sample
        self._publish_pad(t_ns)
        self._box.put(box.pack_board(box.PAD_KIND, *sample, self._pad.mode), t_ns)
        if news.cause:
            text = f"{news.cause}; last frames: {self._pad.recent()}"
            self._note("pad", text, {"reason": str(news.cause)})

    def _on_servo(self, answer: interface.Value, t_ns: int) -> None:
        self._rings["servos"].put(records.SERVO.pack(*answer), t_ns)
        self._box.put(box.pack_board(box.SERVO_KIND, *answer), t_ns)
        self._gate_bell.ring()

    def _on_health(self, rows: interface.Value, t_ns: int) -> None:
        self._latest["health"].write(records.HEALTH.pack(*rows), t_ns)
        wrong, told = servos.servo_faults(rows, self._settings), self._servos_told
        self._servos_told = wrong
        for part in [part for part in {**told, **wrong} if told.get(part) != wrong.get(part)]:
            text, level = wrong.get(part, "nothing is wrong any more"), "" if part in wrong else "notice"
            self._note("servo", f"{part}: {text}", {"part": part, "wrong": wrong.get(part, "")}, level=level)
        wheel = servos.missing_wheel(rows, self._settings)
        if wheel and wheel != self._wheel_missing and self._gate.enabled:
            self._raise(causes.WHEEL_MISSING(wheel))
        self._wheel_missing = wheel

    def _on_odd(self, said: interface.Value, t_ns: int) -> None:
        what, value = said
        if text := self._odd.text(what, value):
            self._note("odd", text, {"what": what, "value": value})

    def _on_key(self, sample: interface.Value, t_ns: int) -> None:
        key, event = sample
        self._raise(causes.KEY(key) if key == self._stop_key and event in PRESSES else None)


def run(context: Context) -> int:
    """Run telemetry. It does not end by itself; it is killed when the supervisor dies."""
    telemetry = Telemetry(context)
    context.run(telemetry.turn, telemetry.loop, LONGEST_IDLE_NS)
    return 0
