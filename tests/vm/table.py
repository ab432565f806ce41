"""The trials: what is done, what must be seen, and how the results are shown.

A trial is a function of `inside` (the board on the guest's own vhci_hcd) or of `outside` (on qemu's xHCI, by usbredir).
Its time is counted by the guest's clock and the board's side of the wire, from what `since` says to the first stop.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

INSIDE, OUTSIDE = "inside", "outside"
FLOORS = {INSIDE: "floor", OUTSIDE: "floor_outside"}
"""The trial that is the floor of each guest."""


class Trial(NamedTuple):
    """One row of the table."""

    name: str
    says: str
    where: str
    since: str = ""
    bar_ms: float | None = None
    """For each of its times; None: there is none."""
    floors: float | None = None
    """A bar for their median instead, in floors' medians."""
    times: int = 1
    fresh: bool = False
    """In a guest that has not slept yet: of a second sleep qemu 7.2 was seen to tell nothing. That to disk is last:
    what it left in the swap space held up a reboot."""
    named: bool = False
    """Run only where it is asked for by name: it takes minutes, as a person does."""


@dataclasses.dataclass
class Result:
    """The findings of one round of a trial."""

    trial: str
    ms: float | None = None
    missed: int = 0
    """Stops that were due and that the board did not execute."""
    after: int = 0
    """Motion frames that it executed after the stop."""
    wrong: list[str] = dataclasses.field(default_factory=list)
    """Other faults."""
    note: str = ""


KILLED = ("supervisor", "port_owner", "gate", "telemetry", "stopper")
KILL_FLOORS = 3.0
"""On one processor, where whoever notices waits for the dying to be taken down, as the floor does; and twice, where the
news passes through the supervisor."""

TRIALS = (
    Trial("install", "the Debian package installed, the board plugged in", INSIDE),
    Trial("floor", "the floor: an idle Python process killed, noticed, bytes written", INSIDE, "the kill"),
    Trial("plug", "the plug starts the service that is stopped", INSIDE, "udev's rights", 5000.0),
    *(Trial(f"kill_{name}", f"SIGKILL of the {name}", INSIDE, "the kill", None, KILL_FLOORS, 2) for name in KILLED),
    Trial("crash", "SIGSEGV of the gate, where a program takes the dumps", INSIDE, "the kill", None, KILL_FLOORS, 2),
    Trial("kill_all", "SIGKILL of all at once; ExecStopPost stops", INSIDE, "the kill", 2500.0),
    Trial("stop", "`systemctl stop` while driving", INSIDE, "its exec", 500.0),
    Trial("restart", "`systemctl restart` while driving", INSIDE, "its exec", 500.0),
    Trial("replug", "unplug, and plug after 1.5 s: the same node", INSIDE, "udev's rights", 100.0, times=2),
    Trial("replug_100", "plug within 100 ms of the unplug", INSIDE, "udev's rights", 100.0),
    Trial("replug_20", "plug within 20 ms of the unplug", INSIDE, "udev's rights", 100.0),
    Trial("renumber", "another process holds the old node: a new number", INSIDE, "udev's rights", 100.0),
    Trial("drain", "the board takes no bytes for 2 s, then does", INSIDE, "it takes bytes again", 20.0),
    Trial("drain_kill", "SIGKILL of the port owner while it takes none", INSIDE, "it takes bytes again", 20.0),
    Trial("drain_tool", "`failstop stop --wait 2` beside the stalled service", INSIDE, "it takes bytes again", 20.0),
    Trial("drain_stop", "`systemctl stop` while it takes none", INSIDE, "it takes bytes again", 1000.0),
    Trial("clock", "the clock stepped by +1 h, -2 h, +1 h", INSIDE),
    Trial("autosuspend", "autosuspend allowed, after the kernel's 2 s", INSIDE),
    Trial(
        "suspended",
        "autosuspend allowed, after 0 s: SIGKILL of the gate while the board sleeps",
        INSIDE,
        "the kill",
        200.0,
    ),
    Trial("modem", "a plug without the service: ModemManager does not open the port", INSIDE),
    Trial(
        "setup", "`failstop setup` at a terminal: beside the service, a plug pulled, taken up again", INSIDE, named=True
    ),
    Trial("probe", "`failstop probe` of the board, its plug pulled too", INSIDE, named=True),
    Trial("floor_outside", "the floor, in the guest of the boots", OUTSIDE, "the kill"),
    Trial("sleep", "sleep and resume, the chip keeps its power", OUTSIDE, "the processes run again", 1000.0),
    Trial(
        "sleep_lost",
        "sleep and resume, the chip forgets its speed",
        OUTSIDE,
        "the processes run again",
        1000.0,
        fresh=True,
    ),
    Trial("reboot", "`systemctl reboot` while driving", OUTSIDE, "its exec", 10000.0),
    Trial("boot", "reset of the machine while driving, and boot", OUTSIDE),
    Trial("poweroff", "`systemctl poweroff` while driving", OUTSIDE, "its exec", 10000.0),
    Trial("hibernate", "sleep to disk and resume", OUTSIDE, "the processes run again", 1000.0, fresh=True),
)
TRIAL_BY_NAME = {trial.name: trial for trial in TRIALS}
USUAL = tuple(trial.name for trial in TRIALS if not trial.named)


@dataclasses.dataclass
class Row:
    """A trial with all its rounds."""

    trial: Trial
    results: list[Result]
    floor_ms: float | None = None
    """The median of the same guest."""

    @property
    def problems(self) -> list[str]:
        """Faults; empty when all is as it must be."""
        found = [text for result in self.results for text in result.wrong]
        if not self.results:
            return ["not run"]
        if missed := sum(result.missed for result in self.results):
            found.append(f"{missed} stops missed")
        if after := sum(result.after for result in self.results):
            found.append(f"{after} motion frames after the stop")
        bar_ms = self.trial.bar_ms
        if bar_ms is not None and any(ms > bar_ms for ms in self.times_ms if ms is not None):
            found.append(f"later than {bar_ms:g} ms")
        floors, floor_ms = self.trial.floors, self.floor_ms
        if floors is not None and floor_ms is not None and (median(self.times_ms) or 0.0) > floors * floor_ms:
            found.append(f"later than {floors:g} floors")
        return found

    @property
    def times_ms(self) -> list[float | None]:
        """Of the rounds that have one."""
        return [result.ms for result in self.results if result.ms is not None]


def rows(results: list[Result], names: list[str]) -> list[Row]:
    """The rows of the trials that were to be run, in their order."""
    floors = {where: median([one.ms for one in results if one.trial == floor]) for where, floor in FLOORS.items()}
    return [
        Row(TRIAL_BY_NAME[name], [one for one in results if one.trial == name], floors[TRIAL_BY_NAME[name].where])
        for name in names
    ]


def lives(names: list[str]) -> list[list[str]]:
    """Names of trials, by the guests that they are run in, one after the other."""
    found: list[list[str]] = []
    for name in names:
        if not found or TRIAL_BY_NAME[name].fresh:
            found.append([])
        found[-1].append(name)
    return found


def markdown(found: list[Row]) -> str:
    """The table, for docs/reference/measured.md. A row that is met missed no stop, and nothing moved after one."""
    lines = ["| trial | ms, from what | |", "|---|---|---|"]
    for row in found:
        problems = row.problems
        times = " ".join(f"{ms:.1f}" for ms in row.times_ms)
        since = f"{times}, {row.trial.since}" if times and row.trial.since else times or "-"
        verdict = f"**missed**: {'; '.join(problems)}" if problems else "met"
        notes = "; ".join(dict.fromkeys(result.note for result in row.results if result.note))
        says = row.trial.says + (f" ({notes})" if notes else "")
        lines.append(f"| {says} | {since} | {verdict} |")
    return "\n".join(lines)


def median(times_ms: list[float | None]) -> float | None:
    """The median of those that there are."""
    known = sorted(ms for ms in times_ms if ms is not None)
    return known[len(known) // 2] if known else None


def result(fields: dict[str, Any]) -> Result:
    """A result that came as JSON."""
    return Result(**fields)
