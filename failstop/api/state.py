"""The service's state as one snapshot, for programs and for `failstop status`."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import msgpack

from failstop.api.client import attach
from failstop.api.errors import FailstopError
from failstop.api.run import Run
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.processes import BY_NAME
from failstop.policy.settings import Settings
from failstop.procs.gate.arm.joints import Joint, from_settings
from failstop.procs.telemetry.imu import RATE_VARIANCE
from failstop.procs.telemetry.odometry import POSE_VARIANCE
from failstop.shm import blocks, heartbeat, layout, records


@dataclasses.dataclass(frozen=True)
class Stop:
    """The last stop. Times are None where that level is not known: written (bytes handed to the kernel), acknowledged
    (the board's parser was in sync after it), observed (the IMU says that the wheels are still)."""

    cause: Cause
    reason: str
    """Its text."""
    t: float
    """Unix time."""
    noticed_by: str
    written_by: str
    written_us: float | None
    """From noticing the cause to the burst handed to the kernel."""
    acknowledged_us: float | None
    observed_ms: float | None
    epoch: int = 0
    """That was raised for it: whoever asked for a stop in an earlier one was answered by this."""


@dataclasses.dataclass(frozen=True)
class Process:
    """One process of the service."""

    pid: int
    state: str
    """starting, running, hanging, waiting (to be restarted), down, stopping, or dead (with the supervisor)."""
    age_ms: float
    """Since its last heartbeat."""
    restarts: int
    last_exit: str | None
    """How its predecessor died."""
    worst_ms: float
    """The longest time between two turns of its loop since its start."""
    realtime: bool
    memory_locked: bool
    early_news: bool = True
    """The kernel tells it of a death before it takes the dead process's memory down."""


@dataclasses.dataclass(frozen=True)
class State:
    """One consistent snapshot: what the gate decided is one record, read whole."""

    name: str
    enabled: bool
    estop: str | None
    """The text of `cause`."""
    cause: Cause | None
    """What is latched: the first cause since the last reset; None: nothing is."""
    blocked: str | None
    """Why the wheels may not turn; None when they may."""
    body_vel: tuple[float, float, float]
    """m/s forward, m/s left, rad/s counter-clockwise: what the gate commands now."""
    wheels_rps: tuple[float, float, float, float]
    epoch: int
    waiting_for: str | None
    """What is not up yet; motion can't be enabled until it is."""
    device: dict[str, Any]
    processes: dict[str, Process]
    starved: dict[str, Any] | None
    """How often a process was not run past its deadline, without a stop or a kill for it, since motion was disabled:
    times, longest_ms and process (which it was then); None: never."""
    clients: list[dict[str, Any]]
    """slot, name, pid, driving; and of one that says something of itself (Robot.say): sees, wrong, said_s (how long
    ago)."""
    sources: list[dict[str, Any]]
    """Who drives and who waits, highest priority first."""
    scan_age_s: float | None
    """Since the obstacle sensor delivered last; None: never."""
    last_stop: Stop | None
    imu: dict[str, Any] | None
    """acceleration_mps2 and rate_radps, x forward, y left, z up; the rate less its bias; rate_variance of each axis, in
    (rad/s)2."""
    gyro_bias: dict[str, Any] | None
    """bias_radps, tracking (it follows the reading now), calibrated."""
    odometry: dict[str, float] | None
    """x_m, y_m, th_rad since the start, integrated from what was commanded; pose_variance of each, in m2 and rad2: not
    to be trusted; and the twist, vx_mps, vy_mps, wz_radps, with its standard deviations twist_std_mps of vx and vy and
    twist_std_radps of wz (settings)."""
    pad_mode: str | None
    """locked, drive or joint; None: no gamepad frame yet."""
    battery_mv: int | None
    plugged: str
    """unknown, plugged or unplugged."""
    age_ms: float
    """Of the gate's record."""
    attended_by: list[str] | None = None
    """The operators who are there; None: none is needed (setting attend.required)."""
    arm: dict[str, Any] | None = None
    """None without an arm in the settings. mode (trajectory, follow, jog or nothing), phase, moving, by, closed (why it
    takes no goal), refused (why the last goal of a stream was not taken), released, silent (servos that do not answer),
    wrong (in words), pose (drive, tuck or nothing), auto_tuck_s (until it tucks itself, or None), and joints by name:
    servo, angle_rad and pulses (measured; None before a reading), age_s of that, commanded_rad and commanded_pulses
    (None while it is not known where it is), torque, temperature_c, supply_mv."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as in `failstop status --json`; no word of an arm where there is none."""
        plain = dataclasses.asdict(dataclasses.replace(self, cause=None, last_stop=None))
        for absent in ("arm", "attended_by"):
            if plain[absent] is None:
                del plain[absent]
        return plain | {
            "cause": _plain(self.cause),
            "last_stop": self.last_stop and {**vars(self.last_stop), "cause": _plain(self.last_stop.cause)},
        }


def _plain(cause: Cause | None) -> dict[str, Any] | None:
    """A cause for programs: the name of its row in policy/causes.py, and its arguments."""
    return None if cause is None else {"name": cause.kind.name, **cause.named()}


HANGING_MS = 500.0


class StateReader:
    """Reads snapshots of one run of a service; reads only, and needs no client slot."""

    def __init__(self, name: str, run: Run | None = None) -> None:
        """`run`: the run of this name that is there now, where the caller has it. Raises NoService, FailstopError."""
        self.run = run or Run(name)
        self.name = name
        self.incarnation = self.run.incarnation
        others = (which for which in layout.PROCESSES if which != layout.SUPERVISOR)
        views = {
            layout.SUPERVISOR: self.run.supervisor,
            **{which: attach(name, which, self.run.found) for which in others},
        }
        self._beats = {which: heartbeat.HeartbeatReader(view) for which, view in views.items()}
        self._epoch = views[layout.SUPERVISOR].word("epoch")
        self._table = views[layout.SUPERVISOR].latest_reader("processes")
        self._settings = views[layout.SUPERVISOR].latest_reader("settings")
        self._stop = views[layout.SUPERVISOR].latest_reader("stop")
        self._link = views[layout.SUPERVISOR].latest_reader("link")
        self._latch = views[layout.SUPERVISOR].latest_reader("latch")
        self._gate = views[layout.GATE].latest_reader("state")
        self._said = views[layout.GATE].latest_reader("said")
        self._port = views[layout.PORT_OWNER].latest_reader("port")
        self._stops = views[layout.PORT_OWNER].ring_reader("stops", from_oldest=True)
        self._stopped: tuple[int, Cause | None] = (0, None)
        """The newest epoch in which the port owner stopped by itself, and its first cause there."""
        self._joints: dict[str, Joint] = {}
        self._imu = views[layout.TELEMETRY].latest_reader("imu")
        self._battery = views[layout.TELEMETRY].latest_reader("battery")
        self._bias = views[layout.TELEMETRY].latest_reader("bias")
        self._odometry = views[layout.TELEMETRY].latest_reader("odometry")
        self._pad = views[layout.TELEMETRY].latest_reader("pad")

    def read(self) -> State:
        """A snapshot now. Raises FailstopError while the service has not published one yet."""
        dead = self.run.dead()
        epoch = self._epoch.get()  # before the gate's record: a newer one is then no sign of a stop
        gate, table = self._gate.read(), self._table.read()
        if gate is None or table is None:
            raise FailstopError(f"the service {self.name!r} is still starting: try again in a moment")
        now_ns = time.monotonic_ns()
        battery = records.unpack_battery(found[2]) if (found := self._battery.read()) else None
        decided, cause = self._decided(gate[2], epoch, now_ns, dead=dead)
        known: dict[str, Any] = msgpack.unpackb(table[2])
        return State(
            name=self.name,
            enabled=decided["enabled"],
            estop=str(cause) if cause else None,
            cause=cause,
            blocked=decided["blocked"],
            body_vel=tuple(decided["body_vel"]),
            wheels_rps=tuple(decided["wheels_rps"]),
            epoch=epoch,
            waiting_for=known["waiting_for"],
            device=self._device(),
            processes=self._processes(known["processes"], now_ns, dead=dead),
            starved=known["starved"],
            clients=self._clients(decided["clients"], now_ns),
            sources=decided["sources"],
            scan_age_s=max(0, now_ns - decided["scan_ns"]) / 1e9 if decided["scan_ns"] else None,
            last_stop=self._last_stop(),
            imu=self._sample(),
            gyro_bias=self._gyro_bias(),
            odometry=self._pose(),
            pad_mode=records.PAD_MODES[records.unpack_pad(pad[2])[6]] if (pad := self._pad.read()) else None,
            battery_mv=battery[0] if battery else None,
            plugged=records.PLUGGED[battery[1] if battery else 0],
            age_ms=max(0, now_ns - gate[1]) / 1e6,
            attended_by=decided.get("attended"),
            arm=self._arm(decided.get("arm"), now_ns),
        )

    def _arm(self, found: dict[str, Any] | None, now_ns: int) -> dict[str, Any] | None:
        if found is None:
            return None
        if not self._joints:
            self._joints = {joint.name: joint for joint in from_settings(Settings(dict(self.settings())))}
        joints = {}
        for name, servo, commanded, measured, measured_ns, torque, temperature_c, supply_mv in found["joints"]:
            joint = self._joints[name]
            joints[name] = {
                "servo": servo,
                "pulses": measured,
                "angle_rad": None if measured is None else round(joint.rad(measured), 4),
                "age_s": None if measured is None else max(0, now_ns - measured_ns) / 1e9,
                "commanded_pulses": commanded,
                "commanded_rad": None if commanded is None else round(joint.rad(commanded), 4),
                "torque": torque,
                "temperature_c": temperature_c or None,
                "supply_mv": supply_mv or None,
            }
        return {**found, "joints": joints}

    def settings(self) -> dict[str, float | str]:
        """Every setting that the service was started with, by its whole key. Raises FailstopError while it starts."""
        entry = self._settings.read()
        if entry is None:
            raise FailstopError(f"the service {self.name!r} is still starting: try again in a moment")
        found: dict[str, float | str] = msgpack.unpackb(entry[2])
        return found

    def _decided(self, payload: bytes, epoch: int, now_ns: int, *, dead: bool) -> tuple[dict[str, Any], Cause | None]:
        """What the gate has published, and what is latched. A stop that it has not followed yet, because it hangs or
        has just died, is in force all the same: the port owner admits nothing of an older epoch, nor of the one
        in which it stopped by itself, and the gate's successor starts latched. The same holds for a gate that says on
        what it said before the supervisor died or fell silent."""
        decided: dict[str, Any] = msgpack.unpackb(payload)
        tripped = causes.read(decided["estop"]) if decided["estop"] else None
        cause = self._latched() or tripped
        # Its death comes before what the port owner has noticed of it: the gate dies with it.
        cause = cause or (causes.DIED(layout.SUPERVISOR) if dead else self._own_stop(epoch))
        if not cause and decided["enabled"] and self.run.silent(now_ns):
            cause = causes.SILENT()
        if cause and not tripped:
            decided |= {
                "enabled": False,
                "blocked": f"{blocks.LATCHED}{cause}",
                "body_vel": (0.0, 0.0, 0.0),
                "wheels_rps": (0.0, 0.0, 0.0, 0.0),
                "sources": [],
                "clients": [{**client, "driving": False} for client in decided["clients"]],
            }
        return decided, cause

    def _latched(self) -> Cause | None:
        """By the supervisor's word."""
        entry = self._latch.read()
        since, _, _, cause = records.unpack_latch(entry[2]) if entry else (0, 0, 0, b"")
        return causes.read(cause) if since else None

    def _own_stop(self, epoch: int) -> Cause | None:
        """Why the port owner stopped by itself in this epoch, which the supervisor has not answered yet; else None.
        The first cause wins."""
        while entry := self._stops.next():
            stopped_in, _, _, cause = records.unpack_stop(entry[2])
            if stopped_in > self._stopped[0]:
                self._stopped = stopped_in, causes.read(cause)
        return self._stopped[1] if self._stopped[0] >= epoch else None

    def _clients(self, clients: list[dict[str, Any]], now_ns: int) -> list[dict[str, Any]]:
        entry = self._said.read()
        for slot, t_ns, sees, wrong in msgpack.unpackb(entry[2]) if entry else ():
            for client in clients:
                if client["slot"] == slot:
                    client.update(sees=sees, wrong=wrong, said_s=max(0, now_ns - t_ns) / 1e9)
        return clients

    def _device(self) -> dict[str, Any]:
        entry, link = self._port.read(), self._link.read()
        proof = link[2].decode("ascii", "replace") if link else "unproven"
        if entry is None:
            return {"path": None, "state": "closed", "link": proof}
        _, _, state, path = records.unpack_port(entry[2])
        return {"path": path, "state": records.PORT_STATES[state], "link": proof}

    def _processes(self, table: dict[str, Any], now_ns: int, *, dead: bool) -> dict[str, Process]:
        """`dead`: the supervisor, which keeps the table, has died; two of the others have with it."""
        rows = {layout.SUPERVISOR: {"pid": self._beats[layout.SUPERVISOR].pid.get(), "restarts": 0}, **table}
        if dead:
            left = (name for name in table if BY_NAME[name].outlives_supervisor)
            states = dict.fromkeys(rows, "dead") | dict.fromkeys(left, "stopping")
            rows = {name: {**row, "state": states[name]} for name, row in rows.items()}
        return {name: self._process(name, row, now_ns) for name, row in rows.items()}

    def _process(self, name: str, row: dict[str, Any], now_ns: int) -> Process:
        beat = self._beats[name]
        age_ms = beat.age_ns(now_ns) / 1e6
        state = row.get("state") or heartbeat.STATES[beat.state.get()]
        if state == "running" and age_ms > HANGING_MS:
            state = "hanging"
        granted = beat.rights.get()
        return Process(
            pid=row["pid"],
            state=state,
            age_ms=round(age_ms, 1),
            restarts=row["restarts"],
            last_exit=row.get("last_exit"),
            worst_ms=round(beat.worst_ns.get() / 1e6, 1),
            realtime=bool(granted & heartbeat.REALTIME),
            memory_locked=bool(granted & heartbeat.MEMORY_LOCKED),
            early_news=bool(granted & heartbeat.EARLY_NEWS),
        )

    def _last_stop(self) -> Stop | None:
        entry = self._stop.read()
        if entry is None:
            return None
        found: dict[str, Any] = msgpack.unpackb(entry[2])
        cause = causes.read(found["cause"])
        found |= {"cause": cause, "reason": str(cause)}
        return Stop(**{field.name: found[field.name] for field in dataclasses.fields(Stop)})

    def _sample(self) -> dict[str, Any] | None:
        entry = self._imu.read()
        if entry is None:
            return None
        values = records.unpack_imu(entry[2])
        return {
            "acceleration_mps2": list(values[:3]),
            "rate_radps": list(values[3:]),
            "rate_variance": RATE_VARIANCE,
        }

    def _gyro_bias(self) -> dict[str, Any] | None:
        entry = self._bias.read()
        if entry is None:
            return None
        bias, tracking, calibrated = records.unpack_bias(entry[2])
        return {"bias_radps": list(bias), "tracking": tracking, "calibrated": calibrated}

    def _pose(self) -> dict[str, float] | None:
        entry = self._odometry.read()
        if entry is None:
            return None
        names = ("x_m", "y_m", "th_rad", "vx_mps", "vy_mps", "wz_radps", "twist_std_mps", "twist_std_radps")
        return {**dict(zip(names, records.unpack_odometry(entry[2]), strict=True)), "pose_variance": POSE_VARIANCE}
