"""The table of what is proved: every stop path, the velocities, and the bars. Reaction times are the fault table's."""

from __future__ import annotations

import dataclasses

from failstop.messages.layout import GATE, PORT_OWNER, PROCESS_NAMES, STOPPER, SUPERVISOR, TELEMETRY
from failstop.policy import causes
from failstop.policy.layouts import ACKERMANN
from failstop.policy.settings import ANSWERS_TO_SILENCE, DEATHS, Settings
from failstop_lab.faults import arm_table, processes
from failstop_lab.faults.arm_table import ArmFault
from failstop_lab.faults.fault import Fault, Wanted
from failstop_lab.faults.table import FAULT_BY_NAME
from failstop_lab.prove.others import STRIKE


@dataclasses.dataclass(frozen=True)
class Turning:
    """One way to turn the wheels."""

    name: str
    command: tuple[float, float, float]
    """m/s forward, m/s left, rad/s counter-clockwise."""
    coast_s: float
    """The time from the stop request to rest, s, as measured on the robot with its previous driver."""
    said: str = ""
    """The words for people, if no wheel turns."""
    column: int = 0
    """Its column in MEASURED_S."""

    @property
    def words(self) -> str:
        """For people."""
        if self.said:
            return self.said
        forward, _, turn = self.command
        return f"{forward:g} m/s" if forward else f"{turn:g} rad/s"


TURNINGS = (
    Turning("0.2", (0.2, 0.0, 0.0), 0.40),
    Turning("0.35", (0.35, 0.0, 0.0), 0.50, column=1),
    Turning("turn", (0.0, 0.0, 1.0), 0.25, column=2),
)

SWINGING = Turning("arm", (0.0, 0.0, 0.0), 0.0, "arm swings")
"""Instead of a velocity, for the arm's paths: the wheels stand."""

TIMEOUT = "timeout"
STOP_REQUEST = "request"
DISABLING = "disable"
SCAN = "scan"
PAD_STOP = "pad"
KILL = "kill"
HANG = "hang"
END = "end"
FROZEN = "frozen"
"""Every process stands, and the board's own watchdog is all there is."""
FAULT = "fault"
"""Any other row of the fault table about processes."""
ARM_ROW = "arm"
"""A row of the arm's faults."""
DISABLE_MS = STOP_MS = 5.0
WATCHDOG_MS = 500.0
"""The bar of a board's own watchdog, until the kind of board is known (means.py)."""
_, LATCHES_DEATH, _ = DEATHS
_, _, LATCHES_SILENCE = ANSWERS_TO_SILENCE
LEASED_MS = (processes.LEASE_MS, processes.DEADLINES_MS[PORT_OWNER])
"""The bars of the fault table that are a lease, or a deadline that is never shorter than one."""

KILLED_S = (0.55, 0.55, 0.55)
MEASURED_S: dict[str, tuple[float, float, float]] = {
    TIMEOUT: (0.55, 0.75, 0.50),
    STOP_REQUEST: (0.40, 0.50, 0.25),
    DISABLING: (0.35, 0.75, 0.30),
    SCAN: (0.75, 0.95, 0.70),
    KILL: KILLED_S,
    END: (0.50, 0.50, 0.50),
}
"""Cause to rest, in the order of TURNINGS: what the driver before took on the robot, the bar to beat."""

REST_RESOLUTION_S = 0.1
"""How exactly the moment of rest is known. The IMU gives 110 samples a second, and five to ten are needed to tell rest
from turning."""
ARM_RESOLUTION_S = 0.03
"""How exactly the moment is known at which a joint came to rest, judged by its measured position: 5 pulses at
0.8 rad/s."""
ACKNOWLEDGED_MS = 1000.0
"""From the stop to the answer; a board that is silent for longer counts as deaf."""
SLACK_MS = {False: 20.0, True: 100.0}
"""Added to a reaction's bar: an ordinary process takes the times. More on a simulated board: machines that simulate are
shared and busy."""


@dataclasses.dataclass(frozen=True)
class Path:
    """One stop path."""

    name: str
    kind: str
    words: str
    reaction_ms: float
    """From the cause to the stop handed to the kernel: the bar of the fault table."""
    process: str = ""
    """The process that it strikes."""
    latched: tuple[Wanted, ...] = ()
    """The cause that stays latched is one of these; empty: nothing does."""
    by_gate: bool = False
    """The gate stops with a zero frame of its own instead of a burst."""
    ends: bool = False
    """No service is left."""
    fault: Fault | None = None
    """The row whose steps bring it about; None: it is not done to processes."""
    arm: ArmFault | None = None
    """The row of the arm's faults; None: the wheels turn."""

    by_lease: bool = False
    """A process that it strikes is stopped for when a lease ends, or a deadline that is never shorter than one."""

    def leased(self, lease_s: float) -> Path:
        """The time for a service that has this lease, though its settings give none."""
        lease_ms = lease_s * 1000 + processes.SLACK_MS
        return dataclasses.replace(self, reaction_ms=max(self.reaction_ms, lease_ms)) if self.by_lease else self

    def under(self, settings: Settings) -> Path:
        """The path on a robot with these settings, where a driver that dies or falls silent may latch a stop."""
        # Beside the wheels, the program that moves the arm drives too. Else motion is disabled, and nothing is latched.
        struck = self.arm.what if self.arm and self.arm.wheels_ms is not None else ""
        silent = self.kind == TIMEOUT or struck == arm_table.CLIENT_HANG
        if silent and settings.text("gate.driver_silence") == LATCHES_SILENCE:
            return dataclasses.replace(self, latched=((causes.DRIVER_SILENT,),))
        if struck == arm_table.CLIENT_KILL and settings.text("gate.driver_death") == LATCHES_DEATH:
            return dataclasses.replace(self, latched=((causes.DRIVER_DIED,),))
        # Its arm ends without a burst. The gate stops the wheels, because their commands are missing.
        return dataclasses.replace(self, by_gate=True) if struck == arm_table.CLIENT_HANG else self

    def reaction_bar_ms(self, *, simulated: bool) -> float:
        """The written stop may take this long."""
        return self.reaction_ms + SLACK_MS[simulated]

    def rest_bar_s(self, velocity: Turning) -> float:
        """From the cause to wheels, or a joint, at rest."""
        if self.arm:
            return (self.reaction_ms - STOP_MS + arm_table.BY_ITSELF_MS) / 1000 + ARM_RESOLUTION_S
        if measured := MEASURED_S.get(self.kind):
            return measured[velocity.column] + REST_RESOLUTION_S
        return self.reaction_ms / 1000 + velocity.coast_s + REST_RESOLUTION_S


def of_fault(row: Fault) -> Path:
    """The path of a row that the service survives, and in which only processes are struck."""
    assert row.bar_ms is not None
    leased = row.bar_ms in LEASED_MS
    return Path(row.name, FAULT, row.cause, row.bar_ms, latched=row.latched, fault=row, by_lease=leased)


def _bar(row: str) -> float:
    bar_ms = FAULT_BY_NAME[row].bar_ms
    assert bar_ms is not None
    return bar_ms


def _struck(kind: str, process: str) -> Path:
    row = FAULT_BY_NAME[f"{kind}-{process}"]
    words = f"{process} killed (SIGKILL)" if kind == KILL else f"{process} hangs (SIGSTOP)"
    ends = kind == KILL and process == SUPERVISOR
    latched = row.latched if row.survives else ()
    bar_ms = _bar(row.name)
    return Path(row.name, kind, words, bar_ms, process, latched, ends=ends, fault=row, by_lease=bar_ms in LEASED_MS)


PATHS = (
    Path(TIMEOUT, TIMEOUT, "the commands end", _bar("client-hung"), by_gate=True),
    Path("stop-request", STOP_REQUEST, "a stop request", _bar("stop-request"), latched=((causes.PIPED, STRIKE),)),
    Path(DISABLING, DISABLING, "motion is disabled", DISABLE_MS),
    Path(SCAN, SCAN, "the obstacle sensor falls silent, and comes back", _bar("scan-silent"), by_gate=True),
    Path(PAD_STOP, PAD_STOP, "a button of the gamepad", _bar("pad-button"), latched=((causes.BUTTON,),)),
    *(_struck(KILL, process) for process in PROCESS_NAMES),
    *(_struck(HANG, process) for process in (PORT_OWNER, GATE, TELEMETRY, STOPPER, SUPERVISOR)),
    Path(FROZEN, FROZEN, "the whole service is frozen (SIGSTOP)", WATCHDOG_MS, latched=FAULT_BY_NAME[FROZEN].latched),
    Path("service-stop", END, "the service is stopped (SIGTERM)", _bar("service-stopped"), ends=True),
)


def _moving(row: ArmFault) -> Path:
    """The path of a row of the arm's faults: who stops is asked for what its wheels' row asks for."""
    assert row.bar_ms is not None
    latched = BY_PATH["stop-request"].latched if row.what == arm_table.STOP_REQUEST else row.latched
    reaction_ms = row.bar_ms - arm_table.BY_ITSELF_MS + STOP_MS
    leased = row.what == arm_table.HANG and row.process in (SUPERVISOR, PORT_OWNER)
    return Path(row.name, ARM_ROW, row.cause, reaction_ms, row.process, latched, arm=row, by_lease=leased)


QUICK_PATHS = (TIMEOUT, "stop-request", SCAN, "kill-port_owner", "kill-supervisor", "hang-gate", "hang-port_owner")
"""Each at one velocity in turn, then the board's own watchdog, if it has one, and the service's end."""
QUICK_NAMES = (*QUICK_PATHS, FROZEN, "service-stop")

BY_PATH = {path.name: path for path in PATHS}
BY_TURNING = {velocity.name: velocity for velocity in TURNINGS}
ARM_PATHS = tuple(_moving(row) for row in arm_table.ROWS if row.what in arm_table.SWINGING)
"""Taken once each on a robot with an arm, while one of its joints swings."""
BESIDE_PATHS = tuple(_moving(row) for row in arm_table.BESIDE_ROWS if row.what in arm_table.SWINGING)
"""Taken instead where the arm may move beside the wheels, which turn too."""
ARM_QUICK = ("arm-kill-gate", "arm-client-killed", "arm-stop-request")
BY_ARM_PATH = {path.name: path for path in ARM_PATHS}


def within(settings: Settings, at: tuple[str, ...] = ()) -> list[Turning]:
    """The velocities of the table, each no faster than this robot's limits, and none twice. A steered base, which can't
    turn on the spot, drives a curve instead. `at`: those of these names alone."""
    most_vx, most_wz = settings["limits.vx_mps"], settings["limits.wz_radps"]
    slowest = TURNINGS[0].command[0] if settings.text("wheels.layout") == ACKERMANN else 0.0
    found: dict[tuple[float, float, float], Turning] = {}
    for velocity in TURNINGS:
        forward, aside, turn = velocity.command
        forward = forward or slowest
        command = min(forward, most_vx), aside, min(turn, most_wz)
        name = velocity.name if turn or command[0] == forward else f"{command[0]:g}"
        if not at or velocity.name in at:
            found.setdefault(command, dataclasses.replace(velocity, command=command, name=name))
    return list(found.values())


def plan(
    *,
    quick: bool,
    only: tuple[str, ...] = (),
    at: tuple[str, ...] = (),
    has_arm: bool = False,
    beside: bool = False,
    settings: Settings,
) -> list[tuple[Path, Turning]]:
    """Runs in order: every path at every velocity within the limits of `settings`, or each once. `only` and `at` are
    names of the tables; `has_arm`: the arm's too, but for a plan of velocities; `beside`: it may move beside the
    wheels."""
    velocities = within(settings, at)
    names = only or (QUICK_NAMES if quick else tuple(BY_PATH))
    paths = [path for path in PATHS if path.name in names]
    moving = only or (() if at else ARM_QUICK if quick else tuple(BY_ARM_PATH))
    swinging = within(settings)[0] if beside else SWINGING
    of_arm = BESIDE_PATHS if beside else ARM_PATHS
    swings = [(path, swinging) for path in of_arm if has_arm and path.name in moving]
    if quick:
        return [(path, velocities[number % len(velocities)]) for number, path in enumerate(paths)] + swings
    return [(path, velocity) for velocity in velocities for path in paths] + swings
