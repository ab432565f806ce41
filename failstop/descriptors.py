"""An error that came of too many open files, for people."""

from __future__ import annotations

import errno
import resource

from failstop.procs.rights import no_descriptors


def lack(error: BaseException | None) -> str:
    """What people are told of an error that came of too many open files, whatever was made of it on its way; of another
    one an empty text."""
    while error is not None:
        if isinstance(error, OSError) and error.errno == errno.EMFILE:
            return no_descriptors(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
        error = error.__cause__ or error.__context__
    return ""
