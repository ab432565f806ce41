"""Reasons: every reason that a latch can have, in plain words, with what to see to before it is reset. Pure.

The first row whose pattern is the whole reason counts. Tests hold the table against every reason that the code makes
and against every row of failstop/faults/table.py.
"""

from __future__ import annotations

import re

from failstop.board.decoder import BUTTONS
from failstop.policy.processes import BY_NAME
from failstop.shm.layout import PROCESSES
from failstop.shm.records import REQUESTED

ROLES = {**{name: row.role for name, row in BY_NAME.items()}, "supervisor": "starts and watches the others"}
_PROCESS = "(?P<process>" + "|".join(PROCESSES) + ")"
_TELL = "report it with its incident (`failstop incident list`), as it is a defect, or memory that somebody damaged"
_AGAIN = "look at what came before it (`failstop events`) if it is not the first time"
_BUSY = "look at the machine's load and at real-time rights (`failstop doctor`), since something held it up"
_POWER = "turn the robot's POWER SWITCH off and on, since a stop may not have reached the wheels"


class Reason:
    """One row: the pattern of the reason, what happened, and what to see to. Texts may name the pattern's groups."""

    __slots__ = ("cause", "pattern", "remedy")

    def __init__(self, pattern: str, cause: str, remedy: str) -> None:
        self.pattern = re.compile(pattern, re.DOTALL)
        self.cause = cause
        self.remedy = remedy


TABLE = (
    Reason(f"{_PROCESS} died", "the process {process} died, which {role}", _AGAIN),
    Reason(
        f"{_PROCESS} hangs: (?:silent for )?(?P<ms>\\d+) ms(?: silent)?",
        "the process {process}, which {role}, gave no sign of life for {ms} ms",
        _BUSY,
    ),
    Reason(
        f"{_PROCESS} hangs: (?P<ms>\\d+) ms silent \\(the machine is starved\\)",
        "the machine was busy with other things and did not run the process {process}, which {role}, for {ms} ms",
        "give the service real-time rights (`failstop doctor` has the command), or the machine less to do",
    ),
    Reason(
        r"supervisor was held up for (?P<ms>\d+) ms",
        "the supervisor could not run for {ms} ms, so nobody watched the others",
        _BUSY,
    ),
    Reason(
        r"gate beats but sends nothing: (?P<ms>\d+) ms",
        "the gate was alive, but sent no motor frame for {ms} ms while the wheels turned",
        _TELL,
    ),
    Reason(
        r"the machine was suspended for (?P<s>[\d.]+) s",
        "the machine slept for {s} s, so everything that it knew of the robot was old",
        "keep it from sleeping while the robot is on (`systemctl mask sleep.target`)",
    ),
    Reason(
        r"(?P<what>shared memory \S+|the stop pipe|the bell of the clients) was removed: restart the service",
        "{what}, which others need to find the service, was removed while it ran",
        "look at `failstop doctor`: logind's RemoveIPC=yes removes it when the service's user logs out",
    ),
    Reason(
        "device lost",
        "the board's USB connection was lost; the stop was to be written the moment that it is back",
        "look at the cable, the plug and the board's power",
    ),
    Reason(
        "port does not drain: use the POWER SWITCH",
        "the port took bytes, but they did not leave for the board within 0.1 s",
        _POWER,
    ),
    Reason(
        "the board is deaf: use the POWER SWITCH",
        "the board had answered before and then answered no ping for a second, so it may not hear anything",
        _POWER,
    ),
    Reason(
        "the wheels do not come to rest: use the POWER SWITCH",
        "the IMU saw the robot shake on after a stop, as it does while wheels turn",
        f"{_POWER}; a robot that somebody carries or pushes looks the same",
    ),
    Reason(
        r"command from (?P<who>.+) is not finite",
        "{who} commanded a velocity that is not a number",
        "mend that program, a division by zero for one, before it drives again",
    ),
    Reason(
        r"multiple (?P<source>\S+) publishers: (?P<who>.+? \(pid \d+\)), (?P<rival>.+ \(pid \d+\))",
        "{who} and {rival} both commanded as {source}",
        "end one of them, or give it a source of its own in the settings ([sources.NAME])",
    ),
    Reason(
        r"gamepad button 0x(?P<buttons>[0-9A-F]{4})",
        "somebody pressed {names} on the gamepad",
        "ask whoever holds it",
    ),
    Reason(r"key(?P<key>\d+)", "somebody pressed key {key} on the board", "ask whoever stands by the robot"),
    Reason(
        r"not a motor frame|bad crc|wheel ids .*|limit .* rps, must be .*|wheel \d at .* rps, limit .*",
        "the gate made a frame that must not reach the board ({reason}), and the port owner refused it",
        _TELL,
    ),
    Reason(
        r"stopped by the supervisor(?: \(its reason is damaged\))?",
        "the supervisor stopped the wheels, and why can't be read any more",
        "look at `failstop events`, which may still know",
    ),
    Reason("service is stopping", "the service was told to end", "start it again"),
    Reason("an interlock was lost", "a condition for driving no longer held", "see to that condition"),
    Reason(
        REQUESTED + r"(?:: )?(?P<why>.*) \((?P<who>.+), pid (?P<pid>\d+)\)",
        "{who} (pid {pid}) asked for a stop{said}",
        "make sure that whatever it was for is over",
    ),
    Reason(REQUESTED, "somebody wrote to the stop pipe without saying why", "ask who it was"),
    Reason(
        REQUESTED + r"(?:: )?(?P<why>.*)",
        'somebody wrote to the stop pipe: "{why}"',
        "make sure that whatever it was for is over",
    ),
    Reason(".*", 'the service gave a reason that this version does not know: "{reason}"', _AGAIN),
)


def find(reason: str) -> Reason:
    """The row of a reason."""
    return next(row for row in TABLE if row.pattern.fullmatch(reason))


def explain(reason: str) -> tuple[str, str]:
    """What happened and what to see to, two texts that continue a sentence, for the reason of a latch."""
    row = find(reason)
    found = row.pattern.fullmatch(reason)
    groups = {**(found.groupdict() if found else {}), "reason": reason}
    groups["role"] = ROLES.get(groups.get("process", ""), "")
    groups["names"] = _buttons(groups.get("buttons", "0"))
    why = groups.get("why", "")
    groups["said"] = f': "{why}"' if why else ""
    return row.cause.format_map(groups), row.remedy


def _buttons(mask: str) -> str:
    """Names of the pressed buttons, the bits that have none by number."""
    pressed = int(mask, 16)
    names = [name for name, bit in BUTTONS.items() if pressed & bit]
    names += [f"0x{1 << bit:04X}" for bit in range(16) if pressed & 1 << bit and 1 << bit not in BUTTONS.values()]
    return " and ".join(names)
