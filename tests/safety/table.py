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
    Row("ask for a stop", EVERYONE, "any bytes in the stop pipe are one", "stop"),
    Row("read the state, the events, who drives", EVERYONE, "", "read_state"),
    Row("read the reasons that others give for a stop", EVERYONE, "write nothing private into one", "read_reasons"),
    Row("keep the robot stopped, asking again and again", EVERYONE, "what moves meanwhile is stopped", "keep_stopped"),
    Row("reset and enable", DRIVERS, "", "enable"),
    Row("drive", DRIVERS, "within the limits", "drive"),
    Row("pose as another client: write into its slot", DRIVERS, "within the limits", "pose"),
    Row("take a client slot away from others", DRIVERS, "stops need none", "take_slot"),
    Row("read or take away the stop requests of others", OWNERS, "", "overhear"),
    Row(
        "have a stop shown as somebody else's", NOBODY, "a name in a request is shown as what the asker says",
        "tests/policy/test_causes.py::test_a_forged_sender_is_what_somebody_says",
    ),
    Row("write into the memory of the service's processes", OWNERS, "", "write_memory"),
    Row("remove or replace a segment, a pipe, the lock", OWNERS, "the service sees it, stops and ends", "replace"),
    Row("hold the lock of the name", OWNERS, "", "hold_lock"),
    Row("signal the service's processes", OWNERS, "each death is a stop", "signal_it"),
    Row("open the port beside the service", (ROOT,), "a second service is refused to root too", "open_port_too"),
    Row("take the names of a run's memory before it", NOBODY, "nobody knows them before", "take_names"),
    Row("make a run that has died look alive", OWNERS, "", "look_alive"),
    Row("pass off memory as the service's", OWNERS, "refused by path and owner", "pass_off_memory"),
    Row("pass off a runtime directory as the service's", OWNERS, "refused by path and owner", "pass_off_directory"),
    Row("have root write through a link that is planted", NOBODY, "no link is followed", "plant_link"),
    Row(
        "keep a user without a session from starting a service", EVERYONE,
        "by `/dev/shm/failstop-UID`; never root. The service writes the stop first, and names path and owner",
        "be_in_the_way",
    ),
    Row(
        "keep the service from starting, by filling `/dev/shm`", EVERYONE, "the stop is written first",
        "tests/e2e/test_start_refused.py::test_a_full_file_system",
    ),
    Row(
        "fill the stop pipe so that nobody else's request gets in", EVERYONE, "what fills it is a stop",
        "tests/lab/faults/test_table.py::test_row",
    ),
)  # fmt: skip


def lines() -> list[str]:
    """The table of the page."""
    head = ["", *USERS, ""]
    rows = [[row.what, *("yes" if user in row.can else "no" for user in USERS), row.but] for row in TABLE]
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
