"""Claims that rows of the bench carry: by the pattern that a row's measure begins with, the first that fits. A row with
a bar carries a claim, or is one of CARRY_NONE.
"""

from __future__ import annotations

import re

CLAIMS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"kill [\w ]+ while the arm moves|.* -> every joint stands|.*: not as its row says", ("ARM-1",)),
    ("kill ", ("DEATH-1",)),
    ("hang of ", ("HANG-1",)),
    ("stop request ", ("ASK-1",)),
    ("exec of `failstop run`", ("START-1",)),
    ("replug ", ("PORT-1",)),
    (r"last drive\(\) -> zero frame", ("CLIENT-1",)),
    ("stops missed", ("DEATH-1", "HANG-1")),
    ("motion frames after", ("MOVE-2",)),
    ("systemd: SIGKILL of the supervisor -> stop frame", ("DEATH-1",)),
    ("systemd: SIGKILL of every process at once -> stop frame", ("SEVERAL-1",)),
    ("systemd: `systemctl stop` -> stop frame", ("END-1",)),
    ("systemd: hang of the supervisor -> stop frame", ("HANG-1",)),
    ("systemd: hang of the supervisor -> the service is restarted", ("RETURN-1",)),
    ("systemd: stops missed", ("SEVERAL-1", "END-1")),
    ("systemd: motion frames after", ("MOVE-2",)),
    (r"bridge (killed|stopped \(SIGSTOP\)) while driving", ("CLIENT-1",)),
    (r"SIG\w+ of the policy( and its host)? while driving", ("CLIENT-1",)),
    (r"SIGKILL of [\w ]+ under the policy while driving", ("DEATH-1",)),
    ("second publisher", ("CLIENT-1",)),
)
CARRY_NONE = (
    "processor|memory|start to first state|systemd: boot -> READY",
    r"drive\(\) -> motor frame|cmd_vel published to motor frame|one way, ",
    "kills that found the wheels at rest|systemd: wheels found at rest",
    "streaming jitter|30 Hz, |30 Hz with |moves of the gate|follow at|arm in the settings but absent",
    "failstop against the fastest peer",
)
"""Rows that no claim needs: what the service costs, how soon it begins or obeys, whether a measurement was a good one,
how well the arm moves, and how others do."""


def claims_of(measure: str) -> tuple[str, ...]:
    """The names of the claims that a row of this measure carries (lab/failstop_lab/case/claims.py)."""
    return next((claims for begins, claims in CLAIMS if re.match(begins, measure)), ())


def carries_none(measure: str) -> bool:
    """True for a row that needs no claim."""
    return any(re.match(begins, measure) for begins in CARRY_NONE)
