"""Steps done in their order; when one fails, everything that was done is undone, the last first.

What undoes a step is noted before the step begins, so that one that was cut short is undone too.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import signal
import stat
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Protocol

from failstop.install import InstallError
from failstop.install.layout import MANIFEST_NAME, RUNTIME, STATE
from failstop.install.steps import Command, Directory, File, Link, Remove, Start, Step, Tree

NEW = ".new-by-install"
OLD = ".old-by-install"

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Undo = Callable[[], None]


class Environment(Protocol):
    """What a Tree step writes (tree.Environment)."""

    def write(self, directory: str) -> None:
        """Into a directory that is not there yet. Raises OSError."""


class Machine(Protocol):
    """The system's programs (machine.Machine)."""

    def run(self, words: Sequence[str], accepted: Sequence[int] = (0,)) -> None:
        """Run a program to its end. Raises InstallError on another exit code than the accepted."""

    def start(self, unit: str) -> None:
        """Start a unit and wait until it is ready. Raises InstallError."""


class Doer:
    """Does steps in the system whose root directory is `root`."""

    def __init__(self, root: str, machine: Machine, environment: Environment | None = None) -> None:
        self._root = root
        self._machine = machine
        self._environment = environment
        self._undos: list[Undo] = []
        self._last: list[Undo] = []

    def do(self, steps: Sequence[Step], done: Callable[[Step], None] = lambda step: None) -> list[str]:
        """Do all of them, calling `done` after each; or none. Returns what is left lying about although all is done.
        Raises InstallError, after everything is as it was."""
        doing: Step | None = None
        try:
            for step in steps:
                doing = step
                self._do(step)
                done(step)
        except BaseException as error:
            with _uninterrupted():
                left = _all_of(self._undos[::-1])
            if not isinstance(error, (InstallError, OSError, KeyboardInterrupt)):
                raise
            raise InstallError(_said(doing, error, left)) from error
        with _uninterrupted():
            return _all_of(self._last)

    def _at(self, path: str) -> str:
        return os.path.join(self._root, path.lstrip("/"))

    def _do(self, step: Step) -> None:
        if isinstance(step, Directory):
            self._directory(self._at(step.path))
        elif isinstance(step, File):
            self._file(self._at(step.path), step.data)
        elif isinstance(step, Link):
            self._link(self._at(step.path), step.target)
        elif isinstance(step, Tree):
            self._tree(self._at(step.path), step.manifest)
        elif isinstance(step, Remove):
            self._remove(self._at(step.path), step.only_empty)
        elif isinstance(step, Command):
            self._command(step)
        elif isinstance(step, Start):
            self._start(step.unit)
        else:
            raise AssertionError(f"no such step: {step}")

    def _directory(self, path: str) -> None:
        if not os.path.isdir(path):
            self._undos.append(lambda: _unless_absent(os.rmdir, path))
            os.mkdir(path, 0o755)
            os.chmod(path, 0o755)

    def _file(self, path: str, data: bytes) -> None:
        self._undos.append(_restorer(path))
        self._undos.append(lambda: _unless_absent(os.unlink, path + NEW))
        _write(path + NEW, data)
        os.replace(path + NEW, path)

    def _link(self, path: str, target: str) -> None:
        self._undos.append(_restorer(path))
        self._undos.append(lambda: _unless_absent(os.unlink, path + NEW))
        _unless_absent(os.unlink, path + NEW)
        os.symlink(target, path + NEW)
        os.replace(path + NEW, path)

    def _tree(self, path: str, manifest: bytes) -> None:
        """Written beside, then renamed: what is there is whole at any time."""
        assert self._environment is not None
        # What an installation that lost its power has left.
        _remove(path + NEW)
        self._undos.append(lambda: _remove(path + NEW))
        self._environment.write(path + NEW)
        _write(os.path.join(path + NEW, MANIFEST_NAME), manifest)
        self._aside(path)
        self._undos.append(lambda: _remove(path))
        os.rename(path + NEW, path)

    def _aside(self, path: str) -> None:
        """Move what is at a path out of the way; it is removed when everything is done."""
        _remove(path + OLD)
        if not os.path.lexists(path):
            return
        self._undos.append(lambda: _unless_absent(lambda old: os.rename(old, path), path + OLD))
        self._last.append(lambda: _remove(path + OLD))
        try:
            os.rename(path, path + OLD)
        except OSError as error:
            if error.errno not in (errno.EBUSY, errno.EXDEV) or not os.path.isdir(path):
                raise
            # A mount point stays where it is: what it holds is moved aside in it, and can be moved back there.
            for name in os.listdir(path):
                self._aside(os.path.join(path, name))
            self._last.append(lambda: _remove_emptied(path))

    def _remove(self, path: str, only_empty: bool) -> None:
        if not only_empty:
            self._aside(path)
        else:
            # It may be empty only when what was moved aside is removed.
            self._last.append(lambda: _remove_empty(path))

    def _command(self, step: Command) -> None:
        if step.undo:
            self._undos.append(lambda: self._machine.run(step.undo))
        paths = [self._at(path) for path in step.touches]
        after: dict[str, bytes | None] = {}
        for path in _missing_parents(paths):
            self._undos.append(partial(_remove_empty, path))
        for path in paths:
            self._undos.append(partial(_restore_unless_changed, path, _restorer(path), after))
        if step.words:
            self._machine.run(step.words, step.accepted)
            after.update({path: _content(path) for path in paths})

    def _start(self, unit: str) -> None:
        # systemd makes these for the service, and leaves them.
        for path in map(self._at, (STATE, RUNTIME)):
            if not os.path.isdir(path):
                self._undos.append(partial(_remove, path))
        self._undos.append(lambda: self._machine.run(("systemctl", "stop", unit)))
        self._machine.start(unit)


def _write(path: str, data: bytes) -> None:
    with open(path, "wb") as file:
        file.write(data)
        os.fchmod(file.fileno(), 0o644)
        os.fsync(file.fileno())


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """A second Ctrl-C does not leave half of it, and does not keep what is to be said from being said."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        while signal.sigtimedwait(ENDING, 0):
            pass
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _all_of(acts: Sequence[Undo]) -> list[str]:
    """Do all of them; returns what went wrong."""
    wrong = []
    for act in acts:
        try:
            act()
        except (OSError, InstallError) as error:
            wrong.append(str(error))
    return wrong


def _said(step: Step | None, error: BaseException, left: list[str]) -> str:
    what = f"{step.verb} {step.subject}".strip() if step else "beginning"
    why = "interrupted" if isinstance(error, KeyboardInterrupt) else str(error)
    end = f"; this could NOT be changed back: {'; '.join(left)}" if left else "; everything is as it was before"
    return f"{what}: {why}{end}"


def _unless_absent(act: Callable[[str], None], path: str) -> None:
    with contextlib.suppress(FileNotFoundError):
        act(path)


def _missing_parents(paths: Sequence[str]) -> list[str]:
    """Directories on the way to these paths that are not there, the outermost first."""
    found: set[str] = set()
    for path in paths:
        while not os.path.isdir(path := os.path.dirname(path)):
            found.add(path)
    return sorted(found, key=len)


def _remove_empty(path: str) -> None:
    """A directory, unless it holds something."""
    try:
        os.rmdir(path)
    except OSError as error:
        if error.errno not in (errno.ENOENT, errno.ENOTEMPTY, errno.EBUSY):
            raise


def _remove_emptied(path: str) -> None:
    """A directory that could not be moved aside. Raises InstallError where it can't be removed either."""
    try:
        os.rmdir(path)
    except OSError as error:
        if error.errno != errno.EBUSY:
            raise
        raise InstallError(f"{path} is empty, but a mount of its own") from None


def _content(path: str) -> bytes | None:
    try:
        with open(path, "rb") as file:
            return file.read()
    except FileNotFoundError:
        return None


def _restore_unless_changed(path: str, restore: Undo, after: dict[str, bytes | None]) -> None:
    """Undo what a program wrote into a file of the system's; somebody else's change since then is not thrown away."""
    if after and _content(path) != after[path]:
        raise InstallError(f"{path} was changed by somebody else meanwhile and stays")
    restore()


def _restorer(path: str) -> Undo:
    """What puts a file or link back as it is now, or removes it if it is not there."""
    if os.path.islink(path):
        target = os.readlink(path)

        def restore_link() -> None:
            _unless_absent(os.unlink, path)
            os.symlink(target, path)

        return restore_link
    data = _content(path)
    if data is None:
        return lambda: _unless_absent(os.unlink, path)
    found = os.stat(path)

    def restore() -> None:
        if _content(path) == data:
            return
        with open(path + NEW, "wb") as file:
            file.write(data)
            os.fchown(file.fileno(), found.st_uid, found.st_gid)
            os.fchmod(file.fileno(), stat.S_IMODE(found.st_mode))
        os.replace(path + NEW, path)

    return restore


def _remove(path: str) -> None:
    """Whatever is there."""
    if os.path.isdir(path) and not os.path.islink(path):
        shutil.rmtree(path)
    else:
        _unless_absent(os.unlink, path)
