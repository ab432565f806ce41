"""StateReader: reads the service's state as one snapshot, for programs and for `failstop status`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import cached_property
from math import isnan, nan, pi
from typing import TYPE_CHECKING, Any, TypeVar, cast

import msgpack

from failstop.api import distance, snapshot
from failstop.api.client import SeenRun, attach
from failstop.api.snapshot import ArmState, Imu, JointState, Odometry, Pad, Process, Sample, State, Stop
from failstop.board.kinds import watchdog_of
from failstop.messages import box, layout, records
from failstop.policy import causes, servos
from failstop.policy.causes import Cause
from failstop.policy.joints import Joint, from_settings
from failstop.policy.layouts import ACKERMANN
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.policy.settings import Settings, mounted_wheels
from failstop.shm import heartbeat
from failstop.shm.cell import RingReader
from failstop.shm.thread_state import state_of

if TYPE_CHECKING:
    from failstop.policy.kinematics import Chassis

T = TypeVar("T")

HANGING_S = 0.5
UNITS = {"ms": 1e3, "us": 1e6}
"""The units of times in records, and for each unit how many of them are in one second. The name of a time ends with its
unit, for example `written_ms`."""

ZEROS = (0.0,) * box.MOST_SPEEDS
STANDING: dict[str, Any] = {
    "enabled": False,
    "enabled_ns": 0,
    "body_vel": ZEROS[:3],
    "wheels_rps": ZEROS,
    "sources": [],
}
"""The values in the gate's record while nothing may move."""
NOTHING_YET = {**STANDING, "limit": 100, "estop": None, "blocked": box.DISABLED, "clients": [], "scan_ns": 0}
"""The values that are used instead of the gate's record before the gate has published its first record in this run.
They say that motion is disabled, as it is at the beginning of every run."""
RECORDS: dict[str, tuple[str, Callable[[bytes], Any]]] = {
    "stop": (layout.SUPERVISOR, msgpack.unpackb),
    "link": (layout.SUPERVISOR, lambda payload: payload.decode("ascii", "replace")),
    "latch": (layout.SUPERVISOR, records.LATCH.unpack),
    "state": (layout.GATE, msgpack.unpackb),
    "said": (layout.GATE, msgpack.unpackb),
    "port": (layout.PORT_OWNER, records.PORT.unpack),
    "imu": (layout.TELEMETRY, records.IMU.unpack),
    "wheels": (layout.TELEMETRY, records.WHEELS_SEEN.unpack),
    "scale": (layout.TELEMETRY, msgpack.unpackb),
    "battery": (layout.TELEMETRY, records.BATTERY.unpack),
    "health": (layout.TELEMETRY, records.HEALTH.unpack),
    "bias": (layout.TELEMETRY, records.BIAS.unpack),
    "odometry": (layout.TELEMETRY, records.ODOMETRY.unpack),
    "pad": (layout.TELEMETRY, records.PAD.unpack),
}
"""The records from which a snapshot is made. Each has the process that writes it, and the function that decodes it."""

PLUGGED: tuple[Any, ...] = records.PLUGGED
WHEELS_DO: tuple[Any, ...] = records.WHEELS_DO
WHEELS_BY: tuple[Any, ...] = records.WHEELS_BY
ODOMETRY_FROM: tuple[Any, ...] = records.ODOMETRY_FROM
PAD_MODES = cast("tuple[snapshot.PadMode, ...]", records.PAD_MODES)


def _imu(t_ns: int, *values: float) -> Imu:
    return Imu(t_ns, values[:3], values[3:])


def _odometry(t_ns: int, *values: Any) -> Odometry:
    return Odometry._make((t_ns, *values[:8], ODOMETRY_FROM[values[8]], values[9:]))


def _pad(t_ns: int, buttons: int, hat: int, *rest: int) -> Pad:
    return Pad(t_ns, buttons, hat, rest[:-1], PAD_MODES[rest[-1]])


SAMPLES: dict[int, Callable[..., Sample]] = {box.IMU_KIND: _imu, box.PAD_KIND: _pad}
"""The kinds of the board's reports that samples() returns, each with the function that makes the sample. Reports of
every other kind appear only in State."""


class StateReader(SeenRun):
    """Reads snapshots of one run of a service. It only reads, so it needs no client slot."""

    def __init__(self, name: str) -> None:
        """Raises NoService, FailstopError."""
        super().__init__(name)
        others = (which for which in layout.PROCESS_NAMES if which != layout.SUPERVISOR)
        views = {layout.SUPERVISOR: self.supervisor, **{which: attach(name, which, self.found) for which in others}}
        self._beats = {which: heartbeat.HeartbeatReader(view) for which, view in views.items()}
        self._epoch = self.supervisor.word("epoch")
        self._latest = {record: views[whose].latest_reader(record) for record, (whose, _) in RECORDS.items()}
        self._telemetry = views[layout.TELEMETRY]
        self._unheeded, self._said = self._telemetry.word("unheeded_ns"), self._telemetry.word("said_ns")
        self._sampled: Odometry | None = None

    def _value(self, record: str) -> Any:
        """The newest value of a record in RECORDS. None if it has no value yet."""
        entry = self._latest[record].read()
        return RECORDS[record][1](entry[2]) if entry else None

    def _timed(self, record: str, make: Callable[..., T]) -> T | None:
        """The newest value of a record with its time, converted by `make`. None if it has no value yet."""
        entry = self._latest[record].read()
        return make(entry[1], *RECORDS[record][1](entry[2])) if entry else None

    def settings(self) -> dict[str, float | str]:
        """Every setting with which the service was started, by its full key. Raises FailstopError."""
        found: dict[str, float | str] = self.run_record("settings")[1]
        return found

    @cached_property
    def _box(self) -> RingReader:
        return self._telemetry.ring_reader("box")

    def samples(self) -> list[Sample]:
        """The samples from the board's reports since the last call, in order, and then the newest odometry if it has
        changed."""
        found = []
        while entry := self._box.next():
            kind, values = box.unpack_board(entry[2])
            if make := SAMPLES.get(kind):
                found.append(make(entry[1], *values))
        if (odometry := self._timed("odometry", _odometry)) and odometry != self._sampled:
            self._sampled = odometry
            found.append(odometry)
        return found

    @cached_property
    def _declared(self) -> Settings:
        return Settings(dict(self.settings()))

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """The arm's joints by name. Raises FailstopError."""
        return {joint.name: joint for joint in from_settings(self._declared)}

    @cached_property
    def _lease_s(self) -> float:
        return float(self.settings()["gate.lease_s"])

    @cached_property
    def _mounted(self) -> list[tuple[int, float]]:
        """(index, factor) for each wheel. `index`: the place of the wheel's speed in the gate's record. `factor`:
        converts that speed to rad/s, positive forward."""
        return [(id_, sign * 2 * pi) for id_, sign in mounted_wheels(self.settings())]

    @cached_property
    def _chassis(self) -> Chassis:
        from failstop.policy.kinematics import from_settings as chassis_of  # only drive_wheels() needs it

        return chassis_of(self._declared)

    def of_wheels(self, speeds_radps: tuple[float, ...], steering_rad: float | None) -> snapshot.Velocity:
        """The velocity of the base at these wheel speeds. Raises FailstopError, and ValueError for a wrong number of
        wheels or for an angle on a base without steering."""
        from failstop.policy.kinematics import of_wheels

        mounted = mounted_wheels(self.settings())
        if len(speeds_radps) != len(mounted):
            names = ", ".join(snapshot.Wheels((0.0,) * len(mounted)).names)
            raise ValueError(f"{len(speeds_radps)} speeds: this robot has {len(mounted)} wheels: {names}")
        return snapshot.Velocity(*of_wheels(self._chassis, mounted, speeds_radps, steering_rad))

    def _steering_rad(self, speeds: tuple[float, ...]) -> float | None:
        """The commanded angle of the steered wheels. It is the last of `speeds`, after the wheels' speeds. None on a
        base without steering. Also None while no wheel is commanded to turn, because the angle has no meaning while the
        wheels stand."""
        steered = self.settings()["wheels.layout"] == ACKERMANN
        return speeds[-1] if steered and any(speeds[at] for at, _ in self._mounted) else None

    @property
    def _nothing_yet(self) -> dict[str, Any]:
        """Return NOTHING_YET, with no operator present if the robot needs an operator."""
        attended: dict[str, Any] = {"attended": ()} if self._declared.on("attend.required") else {}
        return {**NOTHING_YET, **attended}

    def read(self) -> State:
        """Read the state at this moment. Raises FailstopError."""
        decided, cause, epoch, told_ns, dead = self.decided()
        _, known = self.run_record("processes")
        now_ns = time.monotonic_ns()
        millivolts, plugged = self._value("battery") or (0, 0)
        ages, battery_ns = self._ages(now_ns)
        bias, pad = self._value("bias"), self._value("pad")
        starved, attended = known["starved"], decided.get("attended")
        return State(
            name=self.name,
            enabled=decided["enabled"],
            estop=str(cause) if cause else None,
            cause=cause,
            blocked=decided["blocked"],
            body_vel=snapshot.Velocity(*decided["body_vel"]),
            wheels_radps=snapshot.Wheels(decided["wheels_rps"][at] * scale + 0.0 for at, scale in self._mounted),
            epoch=epoch,
            waiting_for=known["waiting_for"],
            device=self._device(),
            processes=self._processes(known["processes"], now_ns, dead=dead),
            starved=starved and _made(snapshot.Starved, starved),
            clients=self._clients(decided["clients"], now_ns),
            sources=tuple(snapshot.Source(**row) for row in decided["sources"]),
            scan_age_s=_age_s(now_ns, decided["scan_ns"]) if decided["scan_ns"] else None,
            last_stop=self._last_stop(),
            imu=self._timed("imu", _imu),
            gyro_bias=bias and snapshot.GyroBias(bias[:3], *bias[3:]),
            odometry=self._timed("odometry", _odometry),
            scale=self._scale(decided.get("capped", "")),
            turning=self._turning(now_ns),
            pad_mode=pad and PAD_MODES[pad[6]],
            battery_v=millivolts / 1000 or None,
            plugged=PLUGGED[plugged],
            speed_limit=decided["limit"] / 100,
            attended_by=None if attended is None else tuple(attended),
            age_s=_age_s(now_ns, told_ns),
            arm=self._arm(decided.get("arm"), now_ns),
            starved_times=known["starved_times"],
            unmet=decided.get("unmet", ""),
            lease_s=self._lease_s,
            steering_rad=self._steering_rad(decided["wheels_rps"]),
            stands_within_m=distance.furthest(self._declared, decided["limit"] / 100)[0],
            enabled_ns=decided.get("enabled_ns", 0),
            servos=servos.by_part(rows, self._declared) if (rows := self._value("health")) else {},
            servos_wrong=servos.servo_faults(rows, self._declared) if rows else {},
            ages=ages,
            battery_ns=battery_ns,
            run=self.found[0].rpartition(".")[2],
        )

    def _ages(self, now_ns: int) -> tuple[snapshot.Ages, int]:
        """The ages of the newest readings, and the time at which the battery was read (ns)."""
        read_ns = {}
        for record in ("battery", "imu", "odometry", "health"):
            entry = self._latest[record].read()
            read_ns[record] = entry[1] if entry else 0
        times_ns = self._said.get(), *read_ns.values()
        ages = [_age_s(now_ns, t_ns) if t_ns else None for t_ns in times_ns]
        return snapshot.Ages(*ages), read_ns["battery"]

    def _arm(self, found: dict[str, Any] | None, now_ns: int) -> ArmState | None:
        if found is None:
            return None
        joints = {}
        for name, servo, commanded, measured, measured_ns, torque, temperature_c, supply_mv in found["joints"]:
            rad = self.joints[name].rad
            angle_rad = None if measured is None else round(rad(measured), 4)
            commanded_rad = None if commanded is None else round(rad(commanded), 4)
            age_s = None if measured is None else _age_s(now_ns, measured_ns)
            known = (temperature_c or None, supply_mv / 1000 or None)
            joints[name] = JointState(servo, angle_rad, measured, age_s, commanded_rad, torque, *known)
        return _made(ArmState, found, joints=joints, silent=tuple(found["silent"]), wrong=tuple(found["wrong"]))

    def decided(self) -> tuple[dict[str, Any], Cause | None, int, int, bool]:
        """Read only the part of the state that drive() needs, because a program calls drive() very often. Returns five
        values: the gate's decision; the cause of the latched stop, or None; the epoch; when the gate published its
        decision (ns); and True if the supervisor is dead. Before the gate's first decision in this run, motion is
        disabled, and the time is the start of the run. Raises FailstopError.

        A latched stop counts here at once, even if the gate has not reacted to it, for example because the gate hangs.
        This is correct, because the port owner refuses motion frames from before the stop, and a new gate begins with
        the latched stop. A dead or silent supervisor also counts as a stop here, whatever the gate publishes.
        """
        dead = self.over()
        epoch = self._epoch.get()  # read before the gate's record, so that a newer epoch is no sign of a stop
        if entry := self._latest["state"].read():
            _, told_ns, payload = entry
            decided: dict[str, Any] = RECORDS["state"][1](payload)
        else:
            told_ns, decided = self.began_ns, self._nothing_yet
        own = causes.read(decided["estop"]) if decided["estop"] else None
        since, _, _, latched = self._value("latch") or (0, 0, 0, b"")
        cause = (causes.read(latched) if since else None) or own
        cause = cause or (causes.DIED(layout.SUPERVISOR) if dead else None)
        if not cause and decided["enabled"] and self.silent(time.monotonic_ns()):
            cause = causes.SILENT()
        if cause and not own:
            clients = [{**client, "driving": False} for client in decided["clients"]]
            decided |= {**STANDING, "blocked": f"{box.LATCHED}{cause}", "clients": clients}
        return decided, cause, epoch, told_ns, dead

    def _clients(self, clients: list[dict[str, Any]], now_ns: int) -> tuple[snapshot.Client, ...]:
        said = {
            slot: {"sees": sees, "wrong": wrong, "said_s": _age_s(now_ns, t_ns)}
            for slot, t_ns, sees, wrong in self._value("said") or ()
        }
        return tuple(snapshot.Client(**client, **said.get(client["slot"], {})) for client in clients)

    def _device(self) -> snapshot.Device:
        # When a run begins, the supervisor has opened the port. Later the port owner reports the port's state.
        *_, state, path = self._value("port") or (records.PORT_OPEN, str(self.settings()["device.path"]))
        found: Any = records.PORT_STATES[state]
        since_ns = self._unheeded.get()
        unheeded_s = (time.monotonic_ns() - since_ns) / 1e9 if since_ns else None
        return snapshot.Device(path, found, self._value("link") or "unproven", *self._watchdog, unheeded_s)

    @cached_property
    def _watchdog(self) -> tuple[float, str, bool]:
        """Return three values: after how many seconds the board's own watchdog acts, what the watchdog does, and True
        if the robot has an IMU. The watchdog of your own board is not known here, because a client does not run the
        board's code."""
        settings = self.settings()
        return *watchdog_of(str(settings["board.kind"])), settings["board.imu"] == "on"

    def _processes(self, table: dict[str, Any], now_ns: int, *, dead: bool) -> dict[str, Process]:
        """The processes by name, from the supervisor's table. `dead`: True if the supervisor has died. Its table is
        then out of date, but the states are known: the gate and telemetry die with the supervisor, and the other two
        processes end soon."""
        pid = self._beats[layout.SUPERVISOR].pid.get()
        found = {}
        for name, row in {layout.SUPERVISOR: {"pid": pid, "restarts": 0, "last_exit": None}, **table}.items():
            beat = self._beats[name]
            # Before the first heartbeat, count from the beginning of the run. Otherwise the age would be that of the
            # computer.
            age_s = (beat.age_ns(now_ns) if beat.ns.get() else max(0, now_ns - self.began_ns)) / 1e9
            state = row.get("state") or heartbeat.STATES[beat.state.get()]
            if dead:
                state = "stopping" if name in table and PROCESS_BY_NAME[name].outlives_supervisor else "dead"
            elif state == "running" and age_s > HANGING_S:
                state = "suspended" if self._is_suspended(row["pid"]) else "hanging"
            granted = beat.rights.get()
            found[name] = _made(
                Process,
                row,
                state=state,
                age_s=round(age_s, 4),
                worst_s=round(beat.worst_ns.get() / 1e9, 4),
                realtime=bool(granted & heartbeat.REALTIME),
                memory_locked=bool(granted & heartbeat.MEMORY_LOCKED),
                starts_in_s=_left_s(row.get("starts_at", 0), now_ns),
                early_news=bool(granted & heartbeat.EARLY_NEWS),
            )
        return found

    def _is_suspended(self, pid: int) -> bool:
        """True if the process is suspended by a signal, for example by Ctrl-Z in its terminal."""
        with contextlib.suppress(OSError):
            return self.shares_pids() and state_of(pid) in ("T", "t")
        return False

    def _turning(self, now_ns: int) -> snapshot.Turning:
        """What telemetry knows about the wheels. A reading that is older than half a second (records.OLD_READING_NS)
        does not show what the wheels do at present."""
        if (found := self._value("wheels")) is None:
            return snapshot.Turning()
        does, by, unexpected, count, since_ns, read_ns, *values = found
        most = records.MOST_WHEELS
        speeds, turns = (self._by_mount(values[at : at + count]) for at in (0, most))
        last = does
        if now_ns - read_ns > records.OLD_READING_NS or not does:
            does, by, unexpected, since_ns = 0, 0, False, read_ns
        return snapshot.Turning(
            does=WHEELS_DO[does],
            by=WHEELS_BY[by],
            unexpected=unexpected,
            since_s=_age_s(now_ns, since_ns) if since_ns else None,
            age_s=_age_s(now_ns, read_ns) if read_ns else None,
            last=WHEELS_DO[last],
            speeds_radps=speeds,
            turned_rad=turns,
        )

    def _scale(self, capped: str) -> snapshot.Scale:
        wheels, turn, wrong, remarks = self._value("scale") or (nan, nan, (), ())
        of_wheels, of_turn = (None if isnan(value) else round(value, 3) for value in (wheels, turn))
        return snapshot.Scale(capped, of_wheels, of_turn, tuple(wrong), tuple(remarks))

    def _by_mount(self, values: list[float]) -> snapshot.Wheels | None:
        """Convert turns to rad, or turns per second to rad/s, positive forward. The given values are in the order of
        the ids on the wire; the result is in the order of the wheels. None if the board does not report one of the
        wheels."""
        if not values or any(value != value for value in values):  # NaN
            return None
        return snapshot.Wheels(values[at] * scale + 0.0 for at, scale in self._mounted if at < len(values))

    def _last_stop(self) -> Stop | None:
        if (found := self._value("stop")) is None:
            return None
        cause = causes.read(found["cause"])
        return _made(Stop, found, cause=cause, reason=str(cause))


def _made(kind: Callable[..., T], record: dict[str, Any], **known: Any) -> T:
    """Make an object of this kind from a record. The values in the record have the same names as the object's fields,
    except that times are converted to s. Values that are no field of the object are left out. `known`: more fields, by
    name."""
    for name, value in record.items():
        stem, _, unit = name.rpartition("_")
        if unit in UNITS:
            known[f"{stem}_s"] = None if value is None else value / UNITS[unit]
        elif name in kind.__dataclass_fields__:  # type: ignore[attr-defined]
            known.setdefault(name, value)
    return kind(**known)


def _left_s(at_ns: int, now_ns: int) -> float | None:
    """How many seconds are left until `at_ns`. Returns None if `at_ns` is 0, which stands for never."""
    return max(0, at_ns - now_ns) / 1e9 if at_ns else None


def _age_s(now_ns: int, t_ns: int) -> float:
    return max(0, now_ns - t_ns) / 1e9


__all__ = ["Process", "State", "StateReader", "Stop"]
