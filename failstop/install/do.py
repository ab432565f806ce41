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

from failstop.install import InstallError
from failstop.install.layout import MANIFEST_NAME, RUNTIME, STATE
from failstop.install.machine import Machine
from failstop.install.steps import Command, Directory, File, Link, Remove, Start, Step, Tree
from failstop.install.tree import Environment

NEW = ".new-by-install"
OLD = ".old-by-install"

STAYS = (errno.ENOENT, errno.ENOTEMPTY, errno.EBUSY)
"""Why a directory is not removed where that is well."""
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Undo = Callable[[], None]


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
        path = self._at(step.subject)
        match step:
            case Directory():
                self._directory(path)
            case File(data=data):
                self._put(path, partial(_write, data=data))
            case Link(target=target):
                self._put(path, partial(os.symlink, target))
            case Tree(manifest=manifest):
                self._put(path, partial(self._tree, manifest))
            case Remove(only_empty=True):
                # It may be empty only when what was moved aside is removed.
                self._last.append(partial(_remove_empty, path, *STAYS))
            case Remove():
                self._aside(path)
            case Command():
                self._command(step)
            case Start():
                self._start(step.subject)
            case _:
                raise AssertionError(f"no such step: {step}")

    def _directory(self, path: str) -> None:
        if not os.path.isdir(path):
            self._undos.append(partial(_remove_empty, path, errno.ENOENT))
            os.mkdir(path, 0o755)
            os.chmod(path, 0o755)

    def _put(self, path: str, make: Callable[[str], None]) -> None:
        """Made beside, then renamed: what is there is whole at any time."""
        new = path + NEW
        # What an installation that lost its power has left.
        _remove(new)
        self._undos.append(partial(_remove, new))
        make(new)
        if os.path.isdir(new) and not os.path.islink(new):
            self._aside(path)
            self._undos.append(partial(_remove, path))
        else:
            self._undos.append(_restorer(path))
        os.replace(new, path)

    def _tree(self, manifest: bytes, path: str) -> None:
        assert self._environment is not None
        self._environment.write(path)
        _write(os.path.join(path, MANIFEST_NAME), manifest)

    def _aside(self, path: str) -> None:
        """Move what is at a path out of the way; it is removed when everything is done."""
        old = path + OLD
        _remove(old)
        if not os.path.lexists(path):
            return
        self._undos.append(partial(_move_back, path))
        self._last.append(partial(_remove, old))
        try:
            os.rename(path, old)
        except OSError as error:
            if error.errno not in (errno.EBUSY, errno.EXDEV) or not os.path.isdir(path):
                raise
            # A mount point stays where it is: what it holds is moved aside in it, and can be moved back there.
            for name in os.listdir(path):
                self._aside(os.path.join(path, name))
            self._last.append(partial(_remove_emptied, path))

    def _command(self, step: Command) -> None:
        if step.undo:
            self._undos.append(partial(self._machine.run, step.undo))
        paths = [self._at(path) for path in step.touches]
        after: dict[str, bytes | None] = {}
        for path in _missing_parents(paths):
            self._undos.append(partial(_remove_empty, path, *STAYS))
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
        self._undos.append(partial(self._machine.run, ("systemctl", "stop", unit)))
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


def _move_back(path: str) -> None:
    with contextlib.suppress(FileNotFoundError):
        os.rename(path + OLD, path)


def _missing_parents(paths: Sequence[str]) -> list[str]:
    """Directories on the way to these paths that are not there, the outermost first."""
    found: set[str] = set()
    for path in paths:
        while not os.path.isdir(path := os.path.dirname(path)):
            found.add(path)
    return sorted(found, key=len)


def _remove_empty(path: str, *accepted: int) -> None:
    """A directory. Raises OSError for another error than the accepted."""
    try:
        os.rmdir(path)
    except OSError as error:
        if error.errno not in accepted:
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
        return partial(_relink, path, os.readlink(path))
    data = _content(path)
    return partial(_remove, path) if data is None else partial(_rewrite, path, data, os.stat(path))


def _relink(path: str, target: str) -> None:
    _remove(path)
    os.symlink(target, path)


def _rewrite(path: str, data: bytes, was: os.stat_result) -> None:
    if _content(path) != data:
        with open(path + NEW, "wb") as file:
            file.write(data)
            os.fchown(file.fileno(), was.st_uid, was.st_gid)
            os.fchmod(file.fileno(), stat.S_IMODE(was.st_mode))
        os.replace(path + NEW, path)


def _remove(path: str) -> None:
    """Whatever is there."""
    if os.path.isdir(path) and not os.path.islink(path):
        shutil.rmtree(path)
    else:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
