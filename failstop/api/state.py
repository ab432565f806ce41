"""StateReader: the service's state as one snapshot, for programs and for `failstop status`."""

from __future__ import annotations

import time
from math import pi
from typing import Any, cast

import msgpack

from failstop.api.client import attach
from failstop.api.errors import FailstopError
from failstop.api.run import Run
from failstop.api.snapshot import (
    ArmState,
    Client,
    Device,
    GyroBias,
    Imu,
    JointState,
    Link,
    Odometry,
    PadMode,
    Plugged,
    PortState,
    Process,
    Source,
    Starved,
    State,
    Stop,
    Velocity,
    Wheels,
)
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.processes import BY_NAME
from failstop.policy.settings import Settings
from failstop.procs.gate.arm.joints import Joint, from_settings
from failstop.procs.telemetry.imu import RATE_VARIANCE
from failstop.procs.telemetry.odometry import POSE_VARIANCE
from failstop.shm import blocks, heartbeat, layout, records

HANGING_S = 0.5
WHEELS = (1, 2, 3, 4)
"""As the settings number them: front and rear on the left, front and rear on the right."""


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
        self._mounted: tuple[tuple[int, float], ...] = ()
        """Of each wheel where its speed is in the gate's record, and what makes forward rad/s of it."""
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
        battery = records.BATTERY.unpack(found[2]) if (found := self._battery.read()) else None
        decided, cause = self._decided(gate[2], epoch, now_ns, dead=dead)
        known: dict[str, Any] = msgpack.unpackb(table[2])
        return State(
            name=self.name,
            enabled=decided["enabled"],
            estop=str(cause) if cause else None,
            cause=cause,
            blocked=decided["blocked"],
            body_vel=Velocity(*decided["body_vel"]),
            wheels_radps=self._wheels(decided["wheels_rps"]),
            epoch=epoch,
            waiting_for=known["waiting_for"],
            device=self._device(),
            processes=self._processes(known["processes"], now_ns, dead=dead),
            starved=_starved(known["starved"]),
            clients=self._clients(decided["clients"], now_ns),
            sources=tuple(Source(**row) for row in decided["sources"]),
            scan_age_s=max(0, now_ns - decided["scan_ns"]) / 1e9 if decided["scan_ns"] else None,
            last_stop=self._last_stop(),
            imu=self._sample(),
            gyro_bias=self._gyro_bias(),
            odometry=self._pose(),
            pad_mode=self._pad_mode(),
            battery_v=battery[0] / 1000 if battery and battery[0] else None,
            plugged=cast("Plugged", records.PLUGGED[battery[1] if battery else 0]),
            attended_by=tuple(names) if (names := decided.get("attended")) is not None else None,
            age_s=max(0, now_ns - gate[1]) / 1e9,
            arm=self._arm(decided.get("arm"), now_ns),
        )

    def decided(self) -> tuple[dict[str, Any], Cause | None]:
        """What the gate has decided last, and what is latched: the part of read() that a driving program needs each
        time. Raises FailstopError."""
        dead = self.run.dead()
        epoch = self._epoch.get()
        gate = self._gate.read()
        if gate is None:
            raise FailstopError(f"the service {self.name!r} is still starting: try again in a moment")
        return self._decided(gate[2], epoch, time.monotonic_ns(), dead=dead)

    def _wheels(self, speeds_rps: list[float]) -> Wheels:
        if not self._mounted:
            given = Settings(dict(self.settings()))
            self._mounted = tuple(
                (int(given[f"wheels.id_{wheel}"]), given[f"wheels.sign_{wheel}"] * 2 * pi) for wheel in WHEELS
            )
        return Wheels(*(speeds_rps[at] * scale + 0.0 for at, scale in self._mounted))

    def _arm(self, found: dict[str, Any] | None, now_ns: int) -> ArmState | None:
        if found is None:
            return None
        if not self._joints:
            self._joints = {joint.name: joint for joint in from_settings(Settings(dict(self.settings())))}
        joints = {}
        for name, servo, commanded, measured, measured_ns, torque, temperature_c, supply_mv in found["joints"]:
            joint = self._joints[name]
            at = measured if commanded is None else commanded
            joints[name] = JointState(
                servo=servo,
                angle_rad=None if measured is None else round(joint.rad(measured), 4),
                pulses=measured,
                age_s=None if measured is None else max(0, now_ns - measured_ns) / 1e9,
                commanded_rad=None if commanded is None else round(joint.rad(commanded), 4),
                commanded_pulses=commanded,
                torque=torque,
                temperature_c=temperature_c or None,
                supply_v=supply_mv / 1000 if supply_mv else None,
                at_rad=None if at is None else round(joint.rad(at), 4),
                at_by="" if at is None else "read" if at == measured else "sent",
            )
        return ArmState(**{**found, "joints": joints, "silent": tuple(found["silent"]), "wrong": tuple(found["wrong"])})

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
        since, _, _, cause = records.LATCH.unpack(entry[2]) if entry else (0, 0, 0, b"")
        return causes.read(cause) if since else None

    def _own_stop(self, epoch: int) -> Cause | None:
        """Why the port owner stopped by itself in this epoch, which the supervisor has not answered yet; else None.
        The first cause wins."""
        while entry := self._stops.next():
            stopped_in, _, _, cause = records.STOPPED.unpack(entry[2])
            if stopped_in > self._stopped[0]:
                self._stopped = stopped_in, causes.read(cause)
        return self._stopped[1] if self._stopped[0] >= epoch else None

    def _clients(self, clients: list[dict[str, Any]], now_ns: int) -> tuple[Client, ...]:
        entry = self._said.read()
        said = {
            slot: {"sees": sees, "wrong": wrong, "said_s": max(0, now_ns - t_ns) / 1e9}
            for slot, t_ns, sees, wrong in (msgpack.unpackb(entry[2]) if entry else ())
        }
        return tuple(Client(**client, **said.get(client["slot"], {})) for client in clients)

    def _device(self) -> Device:
        entry, link = self._port.read(), self._link.read()
        proof = cast("Link", link[2].decode("ascii", "replace") if link else "unproven")
        if entry is None:
            return Device(None, "closed", proof)
        _, _, state, path = records.PORT.unpack(entry[2])
        return Device(path, cast("PortState", records.PORT_STATES[state]), proof)

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
        age_s = beat.age_ns(now_ns) / 1e9
        state = row.get("state") or heartbeat.STATES[beat.state.get()]
        if state == "running" and age_s > HANGING_S:
            state = "hanging"
        granted = beat.rights.get()
        return Process(
            pid=row["pid"],
            state=state,
            age_s=round(age_s, 4),
            restarts=row["restarts"],
            last_exit=row.get("last_exit"),
            worst_s=round(beat.worst_ns.get() / 1e9, 4),
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
        return Stop(
            cause=cause,
            reason=str(cause),
            t=found["t"],
            noticed_by=found["noticed_by"],
            written_by=found["written_by"],
            written_s=_seconds(found["written_us"], 1e6),
            acknowledged_s=_seconds(found["acknowledged_us"], 1e6),
            observed_s=_seconds(found["observed_ms"], 1e3),
            epoch=found["epoch"],
            sent=found["sent"],
        )

    def _pad_mode(self) -> PadMode | None:
        entry = self._pad.read()
        mode = records.PAD_MODES[records.PAD.unpack(entry[2])[6]] if entry else None
        return cast("PadMode | None", mode)

    def _sample(self) -> Imu | None:
        entry = self._imu.read()
        if entry is None:
            return None
        ax, ay, az, *rate = records.IMU.unpack(entry[2])
        x, y, z = rate
        return Imu((ax, ay, az), (x, y, z), RATE_VARIANCE)

    def _gyro_bias(self) -> GyroBias | None:
        entry = self._bias.read()
        if entry is None:
            return None
        x, y, z, tracking, calibrated = records.BIAS.unpack(entry[2])
        return GyroBias((x, y, z), tracking, calibrated)

    def _pose(self) -> Odometry | None:
        entry = self._odometry.read()
        if entry is None:
            return None
        x_m, y_m, th_rad, vx_mps, vy_mps, wz_radps, std_mps, std_radps = records.ODOMETRY.unpack(entry[2])
        return Odometry(x_m, y_m, th_rad, vx_mps, vy_mps, wz_radps, std_mps, std_radps, POSE_VARIANCE)


def _seconds(value: float | None, each: float) -> float | None:
    return None if value is None else value / each


def _starved(found: dict[str, Any] | None) -> Starved | None:
    return None if found is None else Starved(found["times"], found["longest_ms"] / 1000, found["process"])


__all__ = ["Process", "State", "StateReader", "Stop"]
