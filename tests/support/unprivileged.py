"""Doing something as a user who has no rights."""

from __future__ import annotations

import grp
import os
import pwd
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.support.children import NOBODY, become

LOADED = (grp, pwd)
"""Children without privileges may not be able to read the interpreter's files: what refusals need is loaded here."""


def may_reach(path: str) -> bool:
    """True where every user may enter all folders on the way to this file."""
    return all(above.stat().st_mode & 0o001 for above in Path(path).absolute().parents)


def unprivileged(work: Callable[[], str], groups: Sequence[int] = ()) -> str:
    """The result of `work` in a child process without privileges, but in these groups."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            if os.geteuid() == 0:
                become(NOBODY, groups)
            os.write(writer, work().encode())
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return said
