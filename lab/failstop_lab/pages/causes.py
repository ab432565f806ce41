"""The page docs/reference/causes.md: every cause of a stop, made from the table of failstop/policy/causes.py."""

from __future__ import annotations

from failstop.policy import causes
from failstop.policy.causes import Kind

PAGE_HEAD = """\
# Causes

Generated from the table in failstop/policy/causes.py (`make docs`).
`failstop why` explains the cause that is latched in the same words; [the log](../logs.md) finds it afterwards,
and [faults.md](faults.md) says how soon the wheels are stopped for the faults behind it.

Every cause latches: the wheels stay stopped until somebody resets and enables. A cause that only a new start clears
ends the service, or is reported after its end. What a row says about the POWER SWITCH holds until the board
acknowledges the stop; then `failstop why` says that it has, and leaves the switch out.
Words in capitals stand for what differs from case to case: ROLE is what
the process does, N is a number; what is in brackets may be absent. The name is `FAILSTOP_CAUSE` in the journal.
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
