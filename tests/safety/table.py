"""Powers of another local user, and their limits: the rows of docs/safety.md, each with the attempt that shows it."""

from __future__ import annotations

import dataclasses

STRANGER = "any local user"
MEMBER = "group `failstop`"
SERVICE = "the service's user"
ROOT = "root"
USERS = (STRANGER, MEMBER, SERVICE, ROOT)

EVERYONE = USERS
DRIVERS = (MEMBER, SERVICE, ROOT)
OWNERS = (SERVICE, ROOT)
NOBODY: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Row:
    """`attempt`: a function of attempts.py, or the test that shows it, as FILE::FUNCTION."""

    what: str
    can: tuple[str, ...]
    but: str
    attempt: str


TABLE = (
    Row("ask for a stop", EVERYONE, "anything that is written into the stop pipe is a request", "stop"),
    Row("read the state, the events, and which program drives", EVERYONE, "", "read_state"),
    Row(
        "read the reasons that others give for a stop", EVERYONE, "so write nothing private into a reason",
        "read_reasons",
    ),
    Row(
        "keep the robot stopped by asking again and again", EVERYONE,
        "if somebody enables motion in between, the next request stops it", "keep_stopped",
    ),
    Row("reset and enable", DRIVERS, "", "enable"),
    Row("drive", DRIVERS, "within the limits", "drive"),
    Row("pose as another client by writing into its memory slot", DRIVERS, "within the limits", "pose"),
    Row("take client slots away from others", DRIVERS, "a stop request needs no slot", "take_slot"),
    Row("read or take away the stop requests of others", OWNERS, "", "overhear"),
    Row(
        "have a stop shown as somebody else's", NOBODY,
        "if a request contains a name, failstop shows it as text that the sender wrote, next to the real sender",
        "tests/policy/test_causes.py::test_a_forged_sender_is_what_somebody_says",
    ),
    Row("write into the memory of the service's processes", OWNERS, "", "write_memory"),
    Row(
        "remove or replace the service's memory, pipes or lock", OWNERS,
        "if anything but the lock or a client slot is missing, the service stops the wheels and ends", "replace",
    ),
    Row("hold the service's lock", OWNERS, "", "hold_lock"),
    Row("send signals to the service's processes", OWNERS, "if a process dies, the wheels stop", "signal_it"),
    Row(
        "open the port while the service has it", (ROOT,), "but even root can't start a second service on this port",
        "open_port_too",
    ),
    Row(
        "create the shared memory of a run before the run starts", NOBODY, "nobody knows its names in advance",
        "take_names",
    ),
    Row("make a run that has died look alive", OWNERS, "", "look_alive"),
    Row(
        "pass off memory as the service's", OWNERS,
        "memory of other users is refused, and the error names its path and owner", "pass_off_memory",
    ),
    Row(
        "pass off a runtime directory as the service's", OWNERS,
        "a directory of another user is refused, and the error names its path and owner", "pass_off_directory",
    ),
    Row("make root write through a link", NOBODY, "failstop follows no link", "plant_link"),
    Row(
        "prevent a user who has no login session (as in a cron job) from starting a service", EVERYONE,
        "such a user has no `/run/user/UID`, so the service would use `/dev/shm/failstop-UID`, and anybody can create "
        "this folder first. Then the service writes the stop, names the folder and its owner, and ends. Root is never "
        "affected",
        "be_in_the_way",
    ),
    Row(
        "keep the service from starting, by filling `/dev/shm`", EVERYONE, "the service writes the stop before it ends",
        "tests/e2e/test_start_refused.py::test_a_full_file_system",
    ),
    Row(
        "fill the stop pipe, so that no other request gets in", EVERYONE, "the bytes that fill it stop the robot",
        "tests/lab/faults/test_table.py::test_row",
    ),
)  # fmt: skip


def lines() -> list[str]:
    """The table of the page."""
    head = ["attempt", *USERS, "remarks"]
    rows = [[row.what, *("yes" if user in row.can else "no" for user in USERS), row.but] for row in TABLE]
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
