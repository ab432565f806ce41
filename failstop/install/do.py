"""The steps that installing and uninstalling are made of, done in their order; when one fails, everything that was done
is undone, the last first.

What undoes a step is noted before the step begins, so that one that was cut short is undone too.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import os
import shutil
import signal
import stat
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from failstop.install import InstallError
from failstop.install.system import Content, System, content
from failstop.install.tree import Environment

NEW = ".new-by-install"
OLD = ".old-by-install"
STAYS = (errno.ENOENT, errno.ENOTEMPTY, errno.EBUSY)
"""Why a directory is not removed where that is well."""
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Act = Callable[[], object]


@dataclasses.dataclass(frozen=True)
class Step:
    """A verb, what it is done to (a path, a unit, or words for people), a remark. Without a verb it is not shown."""

    verb: str
    subject: str
    remark: str = ""


@dataclasses.dataclass(frozen=True)
class Put(Step):
    """Have a file, mode 0644, a link, the Python environment, or none of them at a path. Directories on the way are
    made, mode 0755."""

    content: Content | Environment = None


@dataclasses.dataclass(frozen=True)
class Discard(Step):
    """Remove a whole directory, which nothing brings back: when every other step is done."""

    only_empty: bool = False
    """One that still holds something stays."""


@dataclasses.dataclass(frozen=True)
class Run(Step):
    """Run a program of the system."""

    words: tuple[str, ...] = ()
    """Empty: nothing now; there is only something to undo."""
    undo: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    """Files that it may write, and directories that it may make; they are put back as they were when it is undone."""
    accepted: tuple[int, ...] = (0,)
    """Exit codes that are well."""


@dataclasses.dataclass(frozen=True)
class Start(Run):
    """Start a unit and wait until it is ready."""


class Doer:
    """Does steps in a system."""

    def __init__(self, system: System) -> None:
        self._system = system
        self._undos: list[Act] = []
        self._last: list[Act] = []

    def do(self, steps: Sequence[Step], done: Callable[[Step], None] = lambda step: None) -> list[str]:
        """Do all of them, calling `done` after each; or none. Returns what is left lying about although all is done.
        Raises InstallError, after everything is as it was."""
        doing: Step | None = None
        try:
            for doing in steps:
                self._do(doing)
                done(doing)
        except BaseException as error:
            left = _all_of(self._undos[::-1])
            if not isinstance(error, (InstallError, OSError, KeyboardInterrupt)):
                raise
            what = f"{doing.verb} {doing.subject}".strip() if doing else "beginning"
            why = "interrupted" if isinstance(error, KeyboardInterrupt) else str(error)
            end = f"this could NOT be changed back: {'; '.join(left)}" if left else "everything is as it was before"
            raise InstallError(f"{what}: {why}; {end}") from error
        return _all_of(self._last)

    def _do(self, step: Step) -> None:
        path = self._system.at(step.subject)
        match step:
            case Put():
                # What an installation that lost its power has left.
                remove(path + NEW)
                remove(path + OLD)
                self._keep([path])
                put(path, step.content)
                self._last.append(partial(remove, path + OLD))
            case Discard():
                self._last.append(partial(_remove_empty, path, *STAYS) if step.only_empty else partial(remove, path))
            case Run():
                paths = [self._system.at(path) for path in step.changes]
                left_as = self._keep(paths)
                if step.undo:
                    self._undos.append(partial(self._system.run, step.undo))
                if isinstance(step, Start):
                    self._system.start(step.subject)
                elif step.words:
                    self._system.run(step.words, step.accepted)
                left_as.update({path: content(path) for path in paths})
            case _:
                raise AssertionError(f"no such step: {step}")

    def _keep(self, paths: Sequence[str]) -> dict[str, Content]:
        """Have what is at these paths put back, and directories that are missing on the way removed again. What is
        returned is to be told how a program has left them: somebody else's change since then is not thrown away."""
        left_as: dict[str, Content] = {}
        self._undos += [partial(_remove_empty, folder, errno.ENOENT) for folder in _missing_parents(paths)]
        self._undos += [partial(_restore, path, _restorer(path), left_as) for path in paths]
        return left_as


def put(path: str, new: Content | Environment, owner: tuple[int, int] | None = None, mode: int = 0o644) -> None:
    """Have it at a path, whole at any time; a directory that is in its place is moved aside."""
    if content(path) == new:
        return
    for folder in _missing_parents([path]):
        os.mkdir(folder)
        os.chmod(folder, 0o755)
    beside = path + NEW
    try:
        if new is None:
            remove(path)
            return
        if isinstance(new, Environment):
            new.write(beside)
            if os.path.isdir(path):
                os.rename(path, path + OLD)
        elif isinstance(new, str):
            os.symlink(new, beside)
        else:
            # Not for others to read before it has its owner.
            with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(new)
                if owner:
                    os.fchown(file.fileno(), *owner)
                os.fchmod(file.fileno(), mode)
                os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        remove(beside)
        raise


def remove(path: str) -> None:
    """Whatever is there. Raises InstallError where it is a mount of its own: that is emptied."""
    try:
        if os.path.isdir(path) and not os.path.islink(path):
            shutil.rmtree(path)
        else:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(path)
    except OSError as error:
        if error.errno != errno.EBUSY:
            raise
        raise InstallError(f"{path} is empty, but a mount of its own") from None


def _remove_empty(path: str, *accepted: int) -> None:
    """A directory. Raises OSError for another error than the accepted."""
    try:
        os.rmdir(path)
    except OSError as error:
        if error.errno not in accepted:
            raise


def _missing_parents(paths: Sequence[str]) -> list[str]:
    """Directories on the way to these paths that are not there, the outermost first."""
    found: set[str] = set()
    for path in paths:
        while not os.path.isdir(path := os.path.dirname(path)):
            found.add(path)
    return sorted(found, key=len)


def _restorer(path: str) -> Act:
    """What puts back a file, a link, or a directory that is moved aside, or removes what is not there yet."""
    if not os.path.lexists(path):
        return partial(remove, path)
    found = os.lstat(path)
    if stat.S_ISDIR(found.st_mode):
        return partial(_move_back, path)
    return partial(put, path, content(path), (found.st_uid, found.st_gid), stat.S_IMODE(found.st_mode))


def _move_back(path: str) -> None:
    if os.path.isdir(path + OLD):
        remove(path)
        os.rename(path + OLD, path)


def _restore(path: str, restore: Act, left_as: Mapping[str, Content]) -> None:
    if path in left_as and content(path) != left_as[path]:
        raise InstallError(f"{path} was changed by somebody else meanwhile and stays")
    restore()


def _all_of(acts: Sequence[Act]) -> list[str]:
    """Do all of them; returns what went wrong. A second Ctrl-C does not leave half of it, and does not keep what is to
    be said from being said."""
    before, wrong = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING), []
    try:
        for act in acts:
            try:
                act()
            except (OSError, InstallError) as error:
                wrong.append(str(error))
    finally:
        while signal.sigtimedwait(ENDING, 0):
            pass
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return wrong
