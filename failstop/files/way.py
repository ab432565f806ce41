"""Way: the folders and links through which a path leads to a file. Each of them may keep a user out, or let others
exchange the file."""

from __future__ import annotations

import contextlib
import errno
import os
import stat

from failstop.files import place

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


def exposed(path: str, root: str = "/") -> str:
    """The file, or the folder on the way to it, that anyone but its owner may change. So others could write another
    text into the file, or put another file in its place. Empty if there is none, as far as this user can see."""
    with contextlib.suppress(OSError):
        for here, found, on_the_way in steps(path, root):
            if place.by_others(found, on_the_way=on_the_way) and not _owner_alone(found):
                return here
    return ""


def _owner_alone(found: os.stat_result) -> bool:
    """True if only a group may write the file, and nobody but the file's owner is in that group. On Debian and Ubuntu,
    every user has such a group, and Ubuntu's umask lets it write to new files."""
    if found.st_mode & stat.S_IWOTH:
        return False
    import grp
    import pwd

    try:
        group = grp.getgrgid(found.st_gid)
        owner = pwd.getpwuid(found.st_uid).pw_name
    except KeyError:
        return False
    members = {*group.gr_mem, *(user.pw_name for user in pwd.getpwall() if user.pw_gid == found.st_gid)}
    return members <= {owner, "root"}


def _parts(path: str) -> list[str]:
    return [part for part in path.split("/")[::-1] if part]
