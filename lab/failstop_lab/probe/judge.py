"""Judge: when the wheels came to rest, by what a board or an odometry reports, or by a person's key. Pure but for the
key.

A rest is between two reports: the first of those that all say the same place and no speed, and the one before it.
"""

from __future__ import annotations

import math
import os
import select
import sys
from collections.abc import Callable, Sequence

from failstop.procs.telemetry.readback import AT_REST
from failstop_lab.prove import shake
from failstop_lab.prove.shake import Noise
from failstop_lab.prove.sight import SeenSample

NEVER_S = 10.0
"""Wheels that turn for longer than this never stop, as far as a person near them is concerned."""
RESTS_S = 0.5
"""A rest lasts for so long before it is believed."""
NS = 1e9
OWN_WORD, GYRO, PERSON, ODOMETER, ROS_IMU = "board's wheels", "board's IMU", "a person's key", "odometry", "IMU"


class Shaking:
    """How the gyro tells rest from turning on this robot."""

    def __init__(self, still: Noise, spinning: Noise) -> None:
        self.still, self.spinning = still, spinning

    def rest_ns(self, samples: Sequence[SeenSample]) -> int | None:
        """The first sample of the rest; None: they shake to the end."""
        return shake.rest_ns(samples, self.still, self.spinning)

    @property
    def least(self) -> float:
        """The least shaking that is turning, rad/s: midway between the loudest rest and the quietest turning."""
        return math.sqrt(self.still.most * self.spinning.least)

    @property
    def distinguishes(self) -> bool:
        """Whether the two can be told apart."""
        return self.still.most < self.spinning.least


def rest_ns(samples: Sequence[SeenSample]) -> int | None:
    """The first report of the rest in which the samples end; None: they end in a turn, or there are none."""
    found = None
    last: tuple[float, ...] | None = None
    for t_ns, speeds, positions in reversed(samples):
        # A driver that was sent NaN may report it: as a speed it is no rest, as a place it is nowhere ever after.
        places = tuple(place for place in positions if not math.isnan(place))
        if not all(abs(speed) <= AT_REST for speed in speeds) or (last is not None and places != last):
            break
        if not speeds and not places:
            continue
        last = places
        found = t_ns
    return found


def dated(samples: Sequence[SeenSample], cause_ns: int, rest: int) -> tuple[float, float]:
    """After how many seconds the wheels came to rest, give or take how many: between the last report that came before
    `rest`, the first of the rest, and that one. Reports that had waited are read one right after the other, and count
    as one."""
    unseen = shake.blind_ns(samples, cause_ns, rest, 0)
    return max(0.0, rest - unseen / 2 - cause_ns) / NS, unseen / 2 / NS


def believed(samples: Sequence[SeenSample], rest: int | None, least_s: float = RESTS_S) -> bool:
    """Whether the rest has lasted. `rest`: its first sample; None: the samples end in a turn."""
    return rest is not None and samples[-1][0] - rest >= least_s * NS


TURNED_S = 0.2
"""Wheels that have been at rest for so long do not turn. A slow wheel may report the same place for a moment."""


def rested(samples: Sequence[SeenSample], rest: int | None) -> bool:
    """Whether the wheels are at rest at the end of these samples, so that no failure after them can stop them. `rest`:
    as for believed()."""
    return believed(samples, rest, TURNED_S)


SILENT_S = 2.0
"""Reports that ended so long before the end of a row say nothing of its end."""
ANSWERS_S = 60.0
PRESS = "Press Enter as soon as the wheels have stopped. If no wheel turns now, press Ctrl-C."
NOT_TURNING = "the wheels were not turning before it"
NO_REPORTS = "{} stopped reporting: watch the wheels, and use --key"
NO_WORD = "nobody said whether the wheels still turned"
NO_JUDGE = "no report shows whether the wheels turn, and there is no terminal to press a key at"


def silent(samples: Sequence[SeenSample], now_ns: int) -> bool:
    """Whether the reports have ended: then nobody saw whether the wheels turned to the end."""
    return not samples or now_ns - samples[-1][0] > SILENT_S * NS


def somebody() -> bool:
    """Whether a person can press a key, or answer."""
    return sys.stdin.isatty()


def turned_on(say: Callable[[str], None], wait: Callable[[float, Callable[[], bool]], bool]) -> str:
    """Ask the person who pressed no key whether the wheels turned to the end; returns why it is not known, empty: they
    did. `wait`: waits for so many seconds, or until it is so."""
    if not somebody():
        return NO_WORD
    say(f"No key within {NEVER_S:g} s. Did the wheels keep turning until the probe stopped them? Type yes or no.")
    said: list[bytes] = []

    def answered() -> bool:
        if select.select([sys.stdin], [], [], 0)[0]:
            said.append(os.read(sys.stdin.fileno(), 4096))
        return bool(said)

    wait(ANSWERS_S, answered)
    return "" if b"".join(said).strip().lower() in (b"y", b"yes") else NO_WORD


def key_pressed() -> bool:
    """Whether a person has pressed Enter since the last look."""
    pressed = False
    while select.select([sys.stdin], [], [], 0)[0]:
        if not os.read(sys.stdin.fileno(), 4096):
            break
        pressed = True
    return pressed
