"""The page docs/reference/causes.md: every cause of a stop, made from the table of failstop/policy/causes.py."""

from __future__ import annotations

from failstop.policy import causes
from failstop.policy.causes import Kind

PAGE_HEAD = """\
# Causes

On this page you can look up why the robot was stopped, and what to do before you reset. `failstop why` explains the
latched cause in the same words. [The log](../logs.md) has the cause of an earlier stop, and [faults.md](faults.md) says
how soon the wheels stop.

Every cause latches: the wheels stay stopped until somebody resets and enables. If only a new start clears a cause, the
service ends, or the cause is reported after its end. If a row mentions the POWER SWITCH, that counts until the board
has acknowledged the stop; `failstop why` then says so, and no longer mentions the switch.

Words in capitals differ from case to case: ROLE is the job of the process, and N is a number. Text in brackets may be
missing. The name is `FAILSTOP_CAUSE` in the journal.

Generated from the table in failstop/policy/causes.py (`make docs`).
"""
ANY_READER = "any program that reads the shared memory"
"""What notices a cause that none of the processes can notice, because they are dead or silent."""


class _Word(str):
    """The place of an argument, however its template formats it."""

    __slots__ = ()

    def __format__(self, form: str) -> str:
        return str(self)


def page() -> str:
    """The whole page."""
    lines = [
        PAGE_HEAD,
        "| text | name | what happened | what to do first | noticed by | cleared by |",
        "|---|---|---|---|---|---|",
        *map(_row, causes.BY_NUMBER.values()),
    ]
    return "\n".join(lines) + "\n"


def _row(kind: Kind) -> str:
    words = {name: _Word(name.upper() if of is str else "N") for name, of in kind.parameters}
    words |= {name: _Word(name.upper()) for name in ("role", "names", *causes.ADVISED)}
    noticed_by = ", ".join(name.replace("_", " ") for name in kind.noticed_by.split()) or ANY_READER
    text, what = (template.format_map(words) for template in (kind.template, kind.what))
    what += f", {kind.doubt}" if kind.doubt else ""
    return (
        f"| `{text}` | `{kind.name}` | {what} | {kind.first().format_map(words)} | {noticed_by} | {kind.cleared_by} |"
    )
