"""The table of the arm's faults. The rows of table.py are of turning wheels: an arm moves while the wheels stand, and
its servos, by the simulated board's word, are what is judged.
"""

from __future__ import annotations

import dataclasses

from failstop.board.servos import LONGEST_MOVE_MS
from failstop.messages.layout import GATE, PROCESS_NAMES, SUPERVISOR
from failstop.policy import causes
from failstop_lab.boards.traits import Traits
from failstop_lab.faults.fault import BY_ENABLE, BY_NEW_RUN, BY_RESET, LATE_MS, Wanted, in_words
from failstop_lab.faults.processes import AT_ONCE_MS, DEADLINES_MS, DEATH_OF, HANG_OF

KILL, HANG, CLIENT_KILL, CLIENT_HANG, STOP_REQUEST, UNPLUG, SECOND, POSING, SERVO_FAULT = (
    "kill",
    "hang",
    "client-kill",
    "client-hang",
    "request",
    "unplug",
    "second",
    "posing",
    "servo",
)
"""The injection."""
CLAIMS = ("ARM-1",)
"""The claims (lab/case/claims.py) that every row carries."""
BY_ITSELF_MS = float(LONGEST_MOVE_MS)
"""The time that a servo goes on for when nobody sends it anything any more."""
STOP_MS = 5.0
GOAL_MS = 500.0
"""After so long without a new goal the gate holds the arm (arm.goal_timeout_s)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ArmFault:
    """One row; every column is given by its name."""

    name: str
    cause: str
    first: str
    """The process that stops the arm first."""
    what: str
    process: str = ""
    latched: tuple[Wanted, ...] = ()
    """The cause that stays latched is one of these; empty: nothing does."""
    cleared: str = BY_ENABLE
    bar_ms: float | None = BY_ITSELF_MS
    """To the last joint at rest; None: motion is not enabled."""
    servo: tuple[tuple[str, float], ...] = ()
    """The fault of the elbow's servo, as the simulated board takes it."""
    refused: str = ""
    """How the answer to an enable begins, behind `arm is not in the drive pose: joint elbow`."""
    weight: int = 1
    """How often a campaign draws it, against the others: it takes seconds."""
    wheels_ms: float | None = None
    """To the stop of the wheels, which turn meanwhile, where the arm may move beside them; None: that is not asked."""

    @property
    def limit_ms(self) -> float | None:
        """A joint that turns later than this fails."""
        return None if self.bar_ms is None else self.bar_ms + LATE_MS

    @property
    def wheels_limit_ms(self) -> float | None:
        """Wheels that are stopped later than this fail."""
        return None if self.wheels_ms is None else self.wheels_ms + LATE_MS

    def at(self, traits: Traits) -> ArmFault:
        """The row as it is for a board: the wheels' stop is later by the board's own line and loop."""
        if self.wheels_ms is None:
            return self
        return dataclasses.replace(self, wheels_ms=self.wheels_ms + traits.own_ns / 1e6)

    def described(self) -> str:
        """The part of its line in docs/reference/faults.md that nothing is measured for."""
        latched = f"`{in_words(self.latched)}`" if self.latched else "nothing"
        return f"| `{self.name}` | {self.cause} | {self.first} | {latched} | {self.cleared} |"


def _kill(process: str) -> ArmFault:
    latched, cleared = ((), BY_NEW_RUN) if process == SUPERVISOR else (((causes.DIED, process),), BY_RESET)
    cause = f"SIGKILL of the {process} while the arm moves"
    return ArmFault(
        name=f"arm-kill-{process}",
        cause=cause,
        first=DEATH_OF[process],
        what=KILL,
        process=process,
        latched=latched,
        cleared=cleared,
        bar_ms=BY_ITSELF_MS + STOP_MS,
    )


def _hang(process: str) -> ArmFault:
    """While motion is disabled nobody watches the gate's lease: its servos stand first, by themselves."""
    first, deadline_ms = HANG_OF[process]
    if process == GATE:
        first, deadline_ms = "each servo, at its move's end; the supervisor, through the port owner", DEADLINES_MS[GATE]
    latched: tuple[Wanted, ...] = ((causes.HANGS, process), (causes.STARVED, process))
    latched, cleared = ((), BY_NEW_RUN) if process == SUPERVISOR else (latched, BY_RESET)
    cause = f"SIGSTOP of the {process} while the arm moves"
    return ArmFault(
        name=f"arm-hang-{process}",
        cause=cause,
        first=first,
        what=HANG,
        process=process,
        latched=latched,
        cleared=cleared,
        bar_ms=BY_ITSELF_MS + deadline_ms,
    )


def _servo(name: str, cause: str, refused: str, **values: float) -> ArmFault:
    first = "gate: motion is not enabled"
    return ArmFault(
        name=f"arm-servo-{name}",
        cause=cause,
        first=first,
        what=SERVO_FAULT,
        bar_ms=None,
        servo=tuple(values.items()),
        refused=refused,
    )


ELSEWHERE = " (servo 3) is "
STOP_REQUESTED: tuple[Wanted, ...] = ((causes.REQUESTED,),)
LOST: tuple[Wanted, ...] = ((causes.DEVICE_LOST,),)
SECOND_CLIENT: tuple[Wanted, ...] = ((causes.TWO_MOVE_THE_ARM,),)
CLAIM = "gate (its client has gone)"
TIME = "gate (no goal for 0.5 s)"
ROWS = (
    *map(_kill, PROCESS_NAMES),
    *map(_hang, PROCESS_NAMES),
    ArmFault(
        name="arm-client-killed",
        cause="SIGKILL of who moves it",
        first=CLAIM,
        what=CLIENT_KILL,
        bar_ms=BY_ITSELF_MS + STOP_MS,
    ),
    ArmFault(
        name="arm-client-hung",
        cause="SIGSTOP of who moves it",
        first=TIME,
        what=CLIENT_HANG,
        bar_ms=BY_ITSELF_MS + GOAL_MS,
    ),
    ArmFault(
        name="arm-second-client",
        cause="a second client moves it",
        first="gate",
        what=SECOND,
        latched=SECOND_CLIENT,
        cleared=BY_RESET,
    ),
    ArmFault(
        name="arm-stop-request",
        cause="a stop request while it moves",
        first="port owner",
        what=STOP_REQUEST,
        latched=STOP_REQUESTED,
        cleared=BY_RESET,
    ),
    ArmFault(
        name="arm-stop-posing",
        cause="a stop request on its way to the drive pose",
        first="port owner",
        what=POSING,
        latched=STOP_REQUESTED,
        cleared=BY_RESET,
    ),
    ArmFault(
        name="arm-usb-drop",
        cause="unplugged while it moves",
        first="each servo, at its move's end",
        what=UNPLUG,
        latched=LOST,
        cleared=BY_RESET,
    ),
    _servo("silent", "a servo does not answer, motion is to be enabled", ": no answer from servo 3", silent=True),
    _servo("blocked", "a joint is blocked, motion is to be enabled", ELSEWHERE, blocked=True),
    _servo("unloaded", "a servo has let go, motion is to be enabled", ELSEWHERE, unloaded=True),
    _servo("hot", "a servo is at 90 degrees, motion is to be enabled", ELSEWHERE, temperature_c=90),
)
ARM_FAULT_BY_NAME = {row.name: row for row in ROWS}
COMMAND_MS = 320.0
"""After so long without a new command the gate stops the wheels (sources.cmd_vel.timeout_s)."""


def _beside(row: ArmFault) -> ArmFault:
    """The row of an arm that moves beside turning wheels, told by the same program: as early as these are stopped it
    has its last goal."""
    wheels_ms: float | None = AT_ONCE_MS
    bar_ms = row.bar_ms
    first = row.first
    if row.what == HANG:
        first, wheels_ms = HANG_OF[row.process]
        bar_ms = BY_ITSELF_MS + wheels_ms
    elif row.what == CLIENT_HANG:
        wheels_ms = COMMAND_MS
    elif row.what == UNPLUG:
        wheels_ms = None
    return dataclasses.replace(
        row, cause=row.cause.replace("the arm moves", BOTH_MOVE), first=first, bar_ms=bar_ms, wheels_ms=wheels_ms
    )


BOTH_MOVE = "wheels and arm move"
BESIDE_ROWS = tuple(_beside(row) for row in ROWS if row.what not in (POSING, SERVO_FAULT))
"""The rows of a board whose arm may move beside the wheels."""
BESIDE_BY_NAME = {row.name: row for row in BESIDE_ROWS}
SWINGING = (KILL, HANG, CLIENT_KILL, CLIENT_HANG, STOP_REQUEST)
"""Faults that can be injected on a stand, to an arm that a program moves."""
