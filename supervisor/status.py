"""Status: publishes why motion can't be enabled yet, and tells the service manager whether the supervisor does its job.

The gate reads the ready word, and clients read the process table. The service manager gets datagrams (the sd_notify
protocol): ready, a status line, watchdog beats, and the end. The supervisor never waits for the service manager. A
datagram that could not be sent is sent again later.

The service manager restarts the service if the watchdog beats stop. They stop only in these cases:

    the supervisor hangs                    so it can't send a beat
    a killed process does not go away       something in the kernel holds it, so the supervisor can't replace it
    a stop can't be written                 although the port is open

In every other case the beats go on, even if a process is down until a reset, the port is gone, or the board is deaf.
The supervisor then still reports, and stops the wheels as far as it can. A restart would interrupt that.

This file also explains what the service loses without real-time rights or early reports of deaths, and which command
grants the rights. It chooses the lease of a service without real-time rights.
"""

from __future__ import annotations

import os

import msgpack

from failstop.messages import layout, records
from failstop.messages.packing import pack
from failstop.notify import Notify
from failstop.policy.processes import PROCESS_BY_NAME, PROCESSES
from failstop.policy.proofs import ALTHOUGH_TOLD_ZERO
from failstop.policy.settings import BY_KEY, Settings
from failstop.procs import rights
from failstop.procs.loop import NEVER
from failstop.shm.heartbeat import EARLY_NEWS, REALTIME
from failstop.supervisor.children import DOWN, RUNNING

TYPE_CHECKING = False
if TYPE_CHECKING:  # commands use only the functions about rights, and don't need these imports
    from collections.abc import Container
    from typing import Any

    from failstop.supervisor.latch import Epochs
    from failstop.supervisor.port_handover import PortHandover
    from failstop.supervisor.process_table import ProcessTable
    from failstop.supervisor.run import Run

UNDYING_NS = 10_000_000_000
"""If a killed process still exists after this time, something in the kernel holds it. Normally it is gone after
milliseconds, or after seconds if it has to close a port that does not drain."""
OWED_NS = 2_000_000_000
"""If a stop is neither answered nor written after this time, the supervisor does not do its job. By then it has tried
to write the stop many times: the first time 5 ms after the cause, and then every 200 ms."""
WAITED_NS = 2_000_000_000
"""If motion can't be enabled for this long, the reason is logged. A restart of a process takes much less time."""
NOTIFY_EVERY_NS = 100_000_000
"""The shortest time between two datagrams for the service manager, because the status line may change often while
someone drives."""

LEASE = "gate.lease_s"
LEASE_S = float(BY_KEY[LEASE].default)
LEASE_WITHOUT_S = 0.2
"""The lease of a service without real-time rights, s, if the user has not chosen a lease.

This is shorter than 0.25 s, the time after which the stopper notices that the port owner hangs, and the supervisor
notices that the gate hangs. So if a process hangs, the others react in the same order as with real-time rights.
"""
OF_A_TIMEOUT = 0.9
"""A lease that failstop chooses without real-time rights is at most this fraction of the shortest command timeout,
because every timeout must be longer than the lease."""

UNIT = "`sudo systemctl edit {unit}`, with LimitRTPRIO=40 and LimitMEMLOCK=infinity under [Service]"
CONTAINER = "start the container with `--cap-add SYS_NICE --cap-add IPC_LOCK --ulimit rtprio=40 --ulimit memlock=-1`"
SHELL = "`sudo prlimit --pid $$ --rtprio=40 --memlock=unlimited` in the same shell, then start it again"
GRANTED = (
    "it has real-time rights, so look what else has them, and at the host of a virtual machine (`failstop doctor`)"
)
NO_REALTIME = "no real-time rights (SCHED_FIFO): on a busy machine stops come later"
NO_EARLY_NEWS = (
    "this kernel reports the death of a process only after it has freed its memory (no robust futexes), so the stop "
    "comes 1 ms later for each 10 MB; run the service on the host's own kernel"
)
CONTAINER_FILES = ("/.dockerenv", "/run/.dockerenv", "/run/.containerenv", "/run/systemd/container")
CONTROL_GROUP = "/proc/self/cgroup"
CONTAINER_VARIABLE = "container"
"""podman, lxc and systemd-nspawn set this variable for the first process of a container. The other processes of the
container inherit the variable, unless a program clears it."""


class Status:
    """Publishes the status. Call publish(), log_waiting() and notify_manager() once per turn. `ever`: True once the
    service has been ready."""

    def __init__(
        self, run: Run, notify: Notify, processes: ProcessTable, epochs: Epochs, handover: PortHandover
    ) -> None:
        self._run = run
        self.notify = notify
        self._processes = processes
        self._epochs = epochs
        self._handover = handover
        self._record = run.own.latest_writer("processes")
        self._table = b""
        self._gate_record = run.views[layout.GATE].latest_reader("state")
        self._wheels_record = run.views[layout.TELEMETRY].latest_reader("wheels")
        self._notified_ns = 0
        self._missing = ""
        self._missing_ns = 0
        self._logged_missing = ""
        self.ever = False
        self.fault = ""
        """Why the supervisor does not do its job. Empty if it does. While this is not empty, no watchdog beats are
        sent."""

    def missing(self, *, stopping: bool) -> str:
        """Why motion can't be enabled yet, as text. Empty if motion can be enabled. `stopping`: True while a stop is
        neither answered nor written."""
        absent = [child.row.name for child in self._processes.children if child.state != RUNNING]
        if not absent and not self._handover.complete():
            return "the port"
        # The port owner must answer the epoch even if the supervisor has written the stop. Otherwise a port owner that
        # was held up could interrupt motion that is enabled later, perhaps after it has written frames of older motion.
        carried_out = self._epochs.answered() and not stopping
        return ", ".join(absent) or ("" if carried_out else "a stop being carried out")

    def publish(self, missing: str) -> bool:
        """Publish the ready word, and the process table if it has changed. `missing`: why motion can't be enabled yet.
        Returns True when the service is ready for the first time."""
        processes = {
            child.row.name: {
                "pid": child.pid,
                "state": child.state,
                "restarts": child.times_restarted,
                "last_exit": child.last_exit or None,
                "killed": child.killed,
                "starts_at": 0 if child.restart.ns == NEVER else child.restart.ns,
            }
            for child in self._processes.children
        }
        table = pack({"waiting_for": missing or None, **self._processes.starved_record(), "processes": processes})
        self._epochs.ready_word.set(not missing)
        if table != self._table:
            self._table = table
            self._record.write(table)
        if missing or self.ever:
            return False
        self.ever, self._logged_missing = True, ""
        text = f"{self._run.name!r} is ready: it has told the wheels to stop, and motion is disabled"
        self._run.events.log("ready", text, step=self._run.events.command("enable"))
        return True

    def log_waiting(self, missing: str, now_ns: int) -> None:
        """Log why motion can't be enabled, if the reason has been the same for WAITED_NS. Later, log that the reason is
        gone, and that motion can be enabled again if no stop is latched. `missing`: the reason, or an empty text if
        motion can be enabled. Call this once per turn."""
        if missing != self._missing:
            self._missing, self._missing_ns = missing, now_ns
        if self._logged_missing == missing:
            return
        if missing and now_ns - self._missing_ns >= WAITED_NS:
            self._logged_missing = missing
            text, step = f"waiting for {missing}: motion can't be enabled", self._run.events.command("status")
            self._run.events.log("waiting", text, {"for": missing}, step=step)
        elif not missing:
            # While a stop is latched, it must be reset first.
            may = "" if self._epochs.latch.stop else ": motion can be enabled again"
            self._run.events.log("ready", f"{self._logged_missing} is there now{may}")
            self._logged_missing = ""

    def notify_manager(self, now_ns: int, missing: str, owed_since_ns: int) -> None:
        """Send the status line and the watchdog beat to the service manager. `missing`: why motion can't be enabled
        yet. `owed_since_ns`: since when a stop is owed (see fault())."""
        if not self.notify.active or now_ns - self._notified_ns < NOTIFY_EVERY_NS:
            return
        self._notified_ns = now_ns
        children, latched, state = self._processes.children, self._epochs.latch.stop, self._gate_record.read()
        killed_ns = {child.row.name: child.fence.kill_ns for child in children if child.fence and child.pid}
        self.fault = fault(now_ns, killed_ns, owed_since_ns)
        down = ", ".join(child.row.name for child in children if child.state == DOWN)
        gate = msgpack.unpackb(state[2]) if state else {}
        wheels = although_told_zero(self._wheels_record.read(), now_ns)
        line = self.fault or status_line(missing, down, str(latched.cause) if latched else "", gate)
        line = "; ".join(filter(None, (wheels.upper(), line)))
        self.notify.update(now_ns, line, ready=self.ever, healthy=not self.fault)


def fault(now_ns: int, killed_ns: dict[str, int], owed_since_ns: int) -> str:
    """Why the supervisor does not do its job, as text. Empty if it does. Pure.

    `killed_ns`: for each process that was killed and still exists, when it was killed. `owed_since_ns`: since when a
    stop is neither answered nor written although the port is open; 0 if no stop is owed.
    """
    for name, since_ns in killed_ns.items():
        if now_ns - since_ns >= UNDYING_NS:
            return f"{name} was killed {(now_ns - since_ns) / 1e9:.0f} s ago and is not gone"
    if owed_since_ns and now_ns - owed_since_ns >= OWED_NS:
        return f"a stop could not be written for {(now_ns - owed_since_ns) / 1e9:.0f} s"
    return ""


def although_told_zero(entry: tuple[int, int, bytes] | None, now_ns: int) -> str:
    """A warning that the wheels turn although zero is commanded. Empty if they don't, or if their newest reading is too
    old. `entry`: telemetry's record about the wheels. Pure."""
    if entry is None:
        return ""
    _, by, unexpected, _, _, read_ns, *_ = records.WHEELS_SEEN.unpack(entry[2])
    fresh = now_ns - read_ns <= records.OLD_READING_NS
    return ALTHOUGH_TOLD_ZERO[records.WHEELS_BY[by]] if unexpected and fresh else ""


def status_line(missing: str, down: str, latched: str, gate: dict[str, Any]) -> str:
    """The service's status in one line. Pure.

    `missing`: why motion can't be enabled yet. `down`: the names of the processes that died too often. `latched`: the
    cause of the latched stop. `gate`: the state that the gate has published. An argument is empty if it does not apply.
    """
    until = "for a minute" if down == layout.GATE else "until a reset"
    stays = f"; {down} died too often and is down {until}" if down else ""
    if latched:
        waits = f"; waiting for {missing}" if missing else ""
        return f"stop latched: {latched}{stays or waits}"
    if missing:
        return f"motion disabled, waiting for {missing}{stays}"
    if not gate.get("enabled"):
        return "ready, motion disabled"
    who = [f"{row['source']} drives: {row['who']}" for row in gate["sources"] if row["state"] == "drives"]
    blocked = f"blocked: {gate['blocked']}" if gate["blocked"] else ""
    return f"motion enabled; {blocked or ', '.join(who) or 'nobody drives'}"


def advice(*, realtime: bool, managed: bool) -> str:
    """What to do if the machine does not run this process in time, with the command in backquotes. `realtime`: True if
    the process has real-time rights. `managed`: True if a service manager started it."""
    if realtime:
        return GRANTED
    # Imported only if rights were refused.
    from failstop.supervisor import refused

    unit = own_unit() if managed else ""
    if by_group := refused.advice_if_allowed(unit=unit, container=in_container()):
        return by_group
    command = UNIT.format(unit=unit) if managed else CONTAINER if in_container() else SHELL
    return f"give it real-time rights: {command}"


def leased(settings: Settings, chosen: Container[str]) -> Settings:
    """These settings, with the lease of lease_without_rights() if this process can't get real-time rights. `chosen`:
    the keys of the settings that the user has chosen. A lease that the user has chosen is not changed."""
    if LEASE in chosen:
        return settings
    with rights.realtime(max(row.priority for row in PROCESSES)) as granted:
        return settings if granted else Settings({**settings.flat(), LEASE: lease_without_rights(settings)})


def lease_without_rights(settings: Settings) -> float:
    """The lease of a service that has no real-time rights, s."""
    timeouts_s = (settings["gate.command_timeout_s"], *(ns / 1e9 for _, ns in settings.sources().values()))
    return max(settings[LEASE], min(LEASE_WITHOUT_S, OF_A_TIMEOUT * min(timeouts_s)))


def cost(lease_s: float) -> str:
    """What the service loses without real-time rights, as part of a sentence. With a long lease, hangs are noticed
    later. With a short lease, the robot also stops if a process only runs late."""
    if lease_s > LEASE_S:
        usual = f"{LEASE_S * 1e3:.0f} to {PROCESS_BY_NAME[layout.PORT_OWNER].deadline_ns / 1e6:.0f}"
        late = f"after {lease_s * 1e3:.0f} ms instead of {usual}"
        return f"when the gate, supervisor or port owner hangs, the robot stops {late} ({LEASE})"
    return f"some stops will have no other reason, because {LEASE} is as short as {lease_s * 1e3:.0f} ms"


def lacking(granted: int, advice: str, lease_s: float) -> list[tuple[str, str]]:
    """The rights that this process did not get, as (the right, a text for people). `granted`: the heartbeat bits of the
    rights that the process has. `lease_s`: the lease in use, s."""
    realtime = f"{NO_REALTIME}, and {cost(lease_s)}; {advice}"
    told = ((REALTIME, "SCHED_FIFO", realtime), (EARLY_NEWS, "robust futexes", NO_EARLY_NEWS))
    return [(what, text) for bit, what, text in told if not granted & bit]


def own_unit() -> str:
    """The name of the systemd unit in which this process runs, from its control group. Returns the placeholder UNIT if
    it runs in no unit."""
    try:
        with open(CONTROL_GROUP, encoding="utf-8", errors="replace") as file:
            groups = [line.rstrip().rpartition("/")[2] for line in file]
    except OSError:
        groups = []
    return next((group for group in groups if group.endswith(".service")), "UNIT")


def in_container() -> bool:
    """True if this process runs in a container. Only common kinds of containers are recognized."""
    return CONTAINER_VARIABLE in os.environ or any(map(os.path.exists, CONTAINER_FILES))
