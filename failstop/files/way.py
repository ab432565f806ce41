"""Way: the folders and links through which a path leads to a file. Each of them may keep a user out, or let others
exchange the file."""

from __future__ import annotations

import errno
import os
import stat

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator

MOST_LINKS = 40
"""How many links the kernel follows."""


def steps(path: str, root: str = "/") -> Iterator[tuple[str, os.stat_result, bool]]:
    """Each folder and link on the way to a file, and at the end the file itself, as (path, status, True if it is on the
    way). Links are followed as the kernel does it. All paths are below `root`. Raises OSError at a place that does not
    exist, or that this user can't see."""
    at, left, links = "/", _parts(os.path.join(os.getcwd(), path)), 0
    yield at, os.lstat(root), bool(left)
    while left:
        name = left.pop()
        if name in (".", ".."):
            at = os.path.dirname(at) if name == ".." else at
            continue
        here = os.path.join(at, name)
        real = os.path.join(root, here.lstrip("/"))
        found = os.lstat(real)
        link = stat.S_ISLNK(found.st_mode)
        yield here, found, link or bool(left)
        if not link:
            at = here
            continue
        links += 1
        if links > MOST_LINKS:
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), path)
        target = os.readlink(real)
        at = "/" if target.startswith("/") else at
        left += _parts(target)


def _parts(path: str) -> list[str]:
    return [part for part in path.split("/")[::-1] if part]
