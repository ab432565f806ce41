"""Metrics: turns a service's state into metrics for Prometheus. A table defines the metrics. Pure.

The names follow Prometheus's rules: base units, with the unit at the end of the name, and `_total` for counters. A
value that is not known has no sample. If no service is running, `failstop_up` is the only metric.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator

from failstop.api import verdict
from failstop.messages import box, records
from failstop.policy.proofs import LINK_ALIVE, LINK_DEAF, LINK_SILENT, LINK_UNASKED, LINK_UNHEARD, LINK_UNPROVEN
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State

    Labels = tuple[tuple[str, str], ...]
    Sample = tuple[Labels, float]
    Read = Callable[[State], Iterable[Sample]]

GAUGE = "gauge"
COUNTER = "counter"
NAMESPACE = "failstop"
LATCHED = "latched"
BLOCKS = {box.DISABLED: "disabled", box.HELD: "held", box.NO_COMMAND: "no_command", box.NO_SCAN: "no_scan"}
OTHER_BLOCK = "other"
PROCESS_STATES = ("starting", "running", "hanging", "suspended", "fenced", "waiting", "down", "stopping", "dead")


@dataclasses.dataclass(frozen=True)
class Family:
    """A metric for Prometheus. `doc`: its help text. `read`: returns its samples from a state."""

    name: str
    kind: str
    doc: str
    labels: tuple[str, ...]
    read: Read


def collect(state: State | None) -> Iterator[tuple[Family, list[Sample]]]:
    """Yield all metrics that have samples. `state`: the service's state, or None if no service is running or the
    service does not answer."""
    yield UP, [((), float(state is not None))]
    if state is not None:
        for family in FAMILIES[1:]:
            if samples := list(family.read(state)):
                yield family, samples


def _one(value: float | None) -> list[Sample]:
    return [] if value is None else [((), float(value))]


def _each(label: str, values: dict[str, float]) -> list[Sample]:
    return [(((label, name),), float(value)) for name, value in values.items()]


def _states(label: str, names: Iterable[str], now: str) -> list[Sample]:
    """Return a sample for each name: 1 for the name that equals `now`, and 0 for all others."""
    return _each(label, {name: float(name == now) for name in dict.fromkeys((*names, now))})


def _ages(state: State) -> list[Sample]:
    """Return the age of each kind of reading. A kind without a reading has no sample."""
    ages = state.ages
    named = {
        "board": ages.board_s,
        "battery": ages.battery_s,
        "imu": ages.imu_s,
        "odometry": ages.odometry_s,
        "servos": ages.servos_s,
        "wheels": state.turning.age_s,
    }
    return _each("reading", {name: age_s for name, age_s in named.items() if age_s is not None})


def _blocked(state: State) -> list[Sample]:
    now = LATCHED if state.cause else BLOCKS.get(state.blocked, OTHER_BLOCK) if state.blocked else ""
    return _each("reason", {name: float(name == now) for name in (LATCHED, *BLOCKS.values(), OTHER_BLOCK)})


def _processes(value: str) -> Read:
    return lambda state: _each("process", {name: getattr(row, value) for name, row in state.processes.items()})


def _living(value: str) -> Read:
    return lambda state: _each(
        "process", {name: getattr(row, value) for name, row in state.processes.items() if row.pid}
    )


def _process_states(state: State) -> list[Sample]:
    return [
        ((("process", name), ("state", word)), float(row.state == word))
        for name, row in state.processes.items()
        for word in dict.fromkeys((*PROCESS_STATES, row.state))
    ]


def _stop(value: str) -> Read:
    return lambda state: _one(getattr(state.last_stop, value) if state.last_stop else None)


def _written(state: State) -> list[Sample]:
    """Return when the last stop was written. Empty while its bytes wait in the kernel because the board accepts none,
    or if they went to a device that has not answered."""
    stop = state.last_stop
    return _one(stop.written_s if stop and stop.sent and stop.believed else None)


def _stop_cause(state: State) -> list[Sample]:
    stop = state.last_stop
    return [((("cause", stop.cause.kind.name), ("noticed_by", stop.noticed_by)), 1.0)] if stop else []


def _wheel_speeds(state: State) -> list[Sample]:
    """Return the measured speed of each wheel. Empty if there is no speed, or if the reading is old."""
    known = state.turning
    if known.speeds_radps is None or not known.by:
        return []
    return _each("wheel", dict(zip(known.speeds_radps.names, known.speeds_radps, strict=True)))


def _joints(value: str) -> Read:
    def read(state: State) -> list[Sample]:
        joints = state.arm.joints if state.arm and state.is_current(None) else {}
        known = {name: getattr(row, value) for name, row in joints.items()}
        return _each("joint", {name: found for name, found in known.items() if found is not None})

    return read


def _servos(at: int) -> Read:
    def read(state: State) -> list[Sample]:
        known = state.servos if state.is_current(state.ages.servos_s) else {}
        return _each("servo", {name: float(told[at]) for name, told in known.items()})

    return read


def _battery_volts(state: State) -> list[Sample]:
    return _one(state.battery_v if state.is_current(state.ages.battery_s) else None)


def _plugged(state: State) -> list[Sample]:
    known = state.plugged if state.is_current(state.ages.battery_s) else ""
    return _one({"plugged": 1.0, "unplugged": 0.0}.get(known))


def _row(name: str, kind: str, doc: str, read: Read, *labels: str) -> Family:
    return Family(f"{NAMESPACE}_{name}", kind, doc, labels, read)


LINKS = (LINK_UNPROVEN, LINK_ALIVE, LINK_DEAF, LINK_SILENT, LINK_UNHEARD, LINK_UNASKED)
SERVICE = (
    _row("up", GAUGE, "1 while the service answers, 0 if not; then this is the only metric", lambda _: ()),
    _row(
        "build_info", GAUGE, "Always 1; the version is the exporter's",
        lambda state: [((("service", state.name), ("version", VERSION)), 1.0)], "service", "version",
    ),
)  # fmt: skip
"""Metrics of the service itself."""
WHEELS = (
    _row("motion_enabled", GAUGE, "1 while motion is enabled", lambda state: _one(state.enabled)),
    _row("moving", GAUGE, "1 while a velocity is commanded", lambda state: _one(state.moving)),
    _row(
        "wheels_may_turn", GAUGE,
        "1 while a stop may not have reached the wheels, or they turn although zero is commanded",
        lambda state: _one(bool(verdict.doubt(state))),
    ),
    _row(
        "wheels_state", GAUGE, "1 for what the wheels do, as far as it is seen: still, turning, or unknown",
        lambda state: _states("state", records.WHEELS_DO, state.turning.does), "state",
    ),
    _row(
        "wheels_seen_by", GAUGE, "1 for what sees the wheels: the board's reports (wheels) or the IMU; all 0: nothing",
        lambda state: _each("source", {name: name == state.turning.by for name in records.WHEELS_BY if name}), "source",
    ),
    _row(
        "wheels_unexpected", GAUGE,
        "1 while the wheels turn although zero has been commanded for longer than still.after_s",
        lambda state: _one(state.turning.unexpected),
    ),
    _row(
        "wheels_reading_age_seconds", GAUGE, "Age of the newest reading of the wheels; missing: no reading yet",
        lambda state: _one(state.turning.age_s),
    ),
    _row(
        "wheel_speed_radians_per_second", GAUGE,
        "Measured speed, positive forward; missing: the board does not report it",
        _wheel_speeds, "wheel",
    ),
)  # fmt: skip
"""Metrics of the motion, and of what the wheels are seen to do."""
STOPS = (
    _row("stop_latched", GAUGE, "1 while a stop is latched", lambda state: _one(state.cause is not None)),
    _row(
        "stop_latched_cause", GAUGE, "1 for the latched cause (docs/reference/causes.md)",
        lambda state: [((("cause", state.cause.kind.name),), 1.0)] if state.cause else [], "cause",
    ),
    _row("blocked", GAUGE, "1 for the reason why the robot may not move; all 0: it may", _blocked, "reason"),
    _row(
        "stops_total", COUNTER,
        "Stops since the service was started, including the stop at the start; a reset does not change it",
        lambda state: _one(state.epoch),
    ),
    _row(
        "last_stop_info", GAUGE, "Always 1; the cause of the last stop, and the process that noticed it",
        _stop_cause, "cause", "noticed_by",
    ),
    _row("last_stop_timestamp_seconds", GAUGE, "When the last stop was, in Unix time", _stop("t")),
    _row(
        "last_stop_written_seconds", GAUGE,
        "From the cause until the kernel had the stop's bytes; missing: NOT written, or not accepted by the board",
        _written,
    ),
    _row(
        "last_stop_acknowledged_seconds", GAUGE, "From the cause to the board's answer; missing: no answer came",
        _stop("acknowledged_s"),
    ),
    _row(
        "last_stop_observed_seconds", GAUGE,
        "From the cause until the wheels were seen still; 0: they did not turn before it either; missing: not seen",
        _stop("observed_s"),
    ),
)  # fmt: skip
"""Metrics of the latch and of the last stop."""
BOARD = (
    _row(
        "velocity_meters_per_second", GAUGE, "Commanded velocity, x forward, y left",
        lambda state: _each("axis", {"x": state.body_vel[0], "y": state.body_vel[1]}), "axis",
    ),
    _row(
        "turn_radians_per_second", GAUGE, "Commanded turn rate, counter-clockwise",
        lambda state: _one(state.body_vel[2])
    ),
    _row(
        "port_state", GAUGE, "1 for the state of the port to the board",
        lambda state: _states("state", records.PORT_STATES, state.device.state), "state",
    ),
    _row(
        "link_state", GAUGE, "1 for what the board's answers prove about the link",
        lambda state: _states("state", LINKS, state.device.link), "state",
    ),
    _row(
        "speed_limit_ratio", GAUGE, "The share of the settings' speeds that drivers may use",
        lambda state: _one(state.speed_limit),
    ),
    _row(
        "battery_volts", GAUGE, "The battery's voltage; missing: not known now",
        _battery_volts,
    ),
    _row(
        "battery_charger_plugged", GAUGE, "1 while the charger is plugged in; missing: not known now",
        _plugged,
    ),
    _row(
        "reading_age_seconds", GAUGE, "Age of the newest reading of each kind; board: of anything that the board sent",
        _ages, "reading",
    ),
)  # fmt: skip
"""Metrics of the commanded velocity, the port and the board."""
PROCESSES = (
    _row("decision_age_seconds", GAUGE, "Age of the gate's last decision", lambda state: _one(state.age_s)),
    _row(
        "scan_age_seconds", GAUGE, "Time since the obstacle sensor last delivered; missing: never",
        lambda state: _one(state.scan_age_s),
    ),
    _row("clients", GAUGE, "Programs that are connected to the service", lambda state: _one(len(state.clients))),
    _row("process_state", GAUGE, "1 for the state of each process", _process_states, "process", "state"),
    _row("process_restarts_total", COUNTER, "Restarts of each process", _processes("restarts"), "process"),
    _row(
        "process_heartbeat_age_seconds", GAUGE, "Time since the last heartbeat of each process",
        _living("age_s"), "process"
    ),
    _row(
        "process_longest_turn_seconds", GAUGE,
        "The longest time between two turns of each process's loop since its start",
        _living("worst_s"), "process",
    ),
    _row(
        "process_realtime", GAUGE, "1 if the process has real-time rights; without them stops come later",
        _processes("realtime"), "process",
    ),
    _row(
        "starved_total", COUNTER, "How often the computer did not run a process in time while motion was disabled",
        lambda state: _one(state.starved_times),
    ),
)  # fmt: skip
"""Metrics of the gate, of the connected programs, and of every process."""
SERVOS = (
    _row(
        "arm_moving", GAUGE, "1 while the arm moves; missing: no arm",
        lambda state: _one(state.arm.moving if state.arm else None),
    ),
    _row(
        "arm_joint_temperature_celsius", GAUGE, "Temperature of each joint's servo, as last read",
        _joints("temperature_c"), "joint"
    ),
    _row(
        "arm_joint_supply_volts", GAUGE, "Supply voltage of each joint's servo, as last read",
        _joints("supply_v"), "joint"
    ),
    _row(
        "servo_temperature_celsius", GAUGE, "Temperature of each servo on the bus, of wheels and joints",
        _servos(1), "servo",
    ),
    _row(
        "servo_load_ratio", GAUGE, "Load of each servo on the bus, as a share of its maximum, signed",
        _servos(0), "servo",
    ),
)  # fmt: skip
"""Metrics of the arm, and of the servos on a bus."""
FAMILIES = (*SERVICE, *WHEELS, *STOPS, *BOARD, *PROCESSES, *SERVOS)
UP = FAMILIES[0]


def markdown() -> list[str]:
    """Return the lines of the metrics table in docs/fleet.md."""
    rows = ["| metric | kind | labels | what it says |", "|---|---|---|---|"]
    for family in FAMILIES:
        labels = ", ".join(f"`{label}`" for label in family.labels)
        rows.append(f"| `{family.name}` | {family.kind} | {labels} | {family.doc} |")
    return rows
