"""Own: your own board. It is a folder whose module wire.py has the board's description: a Wire named WIRE.

The line `VOCABULARY = N` in wire.py names the version of failstop/board/wire.py for which it was written. failstop
reads this line before it runs the module. The modules of the folder import each other with a dot
(`from . import codec`), and failstop's modules in the normal way.

The modules may run as root, in every process of the service. So anyone who can change them can drive the robot.
Therefore the folder, everything in it, and every folder and link on its path must belong to root or to the service's
user. Nobody else may be able to change them. Only source is imported. It is read through the same descriptor that was
checked, so that nobody can exchange the file after the check.

A description is a program, so it may hang or exit. A child process loads and tests it first (sound.py). failstop
refuses the description if the child dies, or has not finished within LIMIT_S.
"""

from __future__ import annotations

# The C module behind `signal`, because importing `signal` also imports enum.
import _signal
import os
import select
import stat
import sys
import time

from failstop.files import place
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator
    from importlib.machinery import ModuleSpec
    from types import ModuleType
    from typing import Any

    from failstop.board.wire import Wire

OWN_PACKAGE = "failstop_own_board"
"""The package name under which Python imports the folder's modules."""
SAYS = b"VOCABULARY = "
"""The beginning of the line that names the version of failstop/board/wire.py for which the description was written."""
LIMIT_S = 5.0
"""How long it may take to load and test the modules of your own board, in s. For the boards that failstop describes
itself, this takes 20 ms."""
_MOST_LINKS = 40
_MOST_FILES = 2000
_MOST_BYTES = 1 << 20
"""The size limit of one module, in bytes."""
_COMPILED = (".so", ".pyc", ".pyd")
_SIGKILL = 9
_SOUND = b"\0"
"""The first byte that the child process sends when it has finished. If it has found a fault, the fault follows as
text."""


class OwnBoardError(ValueError):
    """Raised if the folder can't be used. The message names the folder, and says what to do."""

    def __init__(self, what: str) -> None:
        super().__init__(f"board.kind: {what}")
        self.what = what


def wire(folder: str, *, tried: bool = False) -> Wire:
    """Return the description of your own board, which is in `folder`. A child process first loads and tests it. Set
    `tried` to skip this test if the parent process has already done it. Raises OwnBoardError."""
    from failstop.board.wire import VOCABULARY, Wire

    _check(folder)
    _check_vocabulary(folder, str(VOCABULARY))
    found = load(folder, "wire", "WIRE", tried=tried)
    if not isinstance(found, Wire):
        raise OwnBoardError(f"WIRE of {folder}/wire.py is no failstop.board.wire.Wire")
    return found


def load(folder: str, name: str, value: str, *, tried: bool = False) -> Any:
    """Return a value from a module in the folder of your own board. `tried` is as for wire(). Raises OwnBoardError."""
    _check(folder)
    known = _modules(folder)
    if not tried and name not in known.tried:
        _try(folder, name, value)
        known.tried.add(name)
    return _load(folder, name, value)


def _load(folder: str, name: str, value: str) -> Any:
    path = os.path.join(folder, f"{name}.py")
    try:
        module = __import__(f"{OWN_PACKAGE}.{name}", fromlist=[value])
    except OwnBoardError:
        raise
    except (Exception, SystemExit) as error:
        raise OwnBoardError(f"{path}: {type(error).__name__}: {error}") from error
    found = getattr(module, value, None)
    if found is None:
        raise OwnBoardError(f"{path} has no {value}")
    return found


def _check_vocabulary(folder: str, offered: str) -> None:
    """Raise OwnBoardError unless the description was written for the vocabulary `offered`, the version of
    failstop/board/wire.py."""
    path = os.path.join(folder, "wire.py")
    lines = _source(path).splitlines()
    said = [
        line[len(SAYS) :].partition(b"#")[0].strip().decode("utf-8", "replace")
        for line in lines
        if line.startswith(SAYS)
    ]
    if len(said) > 1:
        raise OwnBoardError(f"{path} has {len(said)} lines that begin with {SAYS.decode()}: keep one of them")
    if said != [offered]:
        written = f"was written for vocabulary {said[0]}" if said else f"has no line {SAYS.decode()}{offered}"
        offers = f"failstop {VERSION} offers vocabulary {offered} of failstop/board/wire.py"
        raise OwnBoardError(f'{path} {written}, and {offers}: docs/porting.md, "Versions"')


# First in a child process.


def _try(folder: str, name: str, value: str) -> None:
    """Load the description and test it in a child process, because it may hang or die. Raises OwnBoardError."""
    path = os.path.join(folder, f"{name}.py")
    try:
        reader, writer = os.pipe()
        child = os.fork()
    except OSError:
        return  # even a machine without room for a child must still write its stop
    if child == 0:
        _judge(folder, name, value, writer)
    os.close(writer)
    try:
        said = _heard(reader, time.monotonic() + LIMIT_S)
    finally:
        os.close(reader)
        ended = _ended(child)
    if said is None:
        raise OwnBoardError(f"{path} has not been loaded within {LIMIT_S:g} s: it hangs, or asks for too much")
    if not said.startswith(_SOUND):
        raise OwnBoardError(f"{path} ended the process that loaded it{ended}: a description only describes")
    if said != _SOUND:
        raise OwnBoardError(said[1:].decode("utf-8", "replace"))


def _judge(folder: str, name: str, value: str, writer: int) -> None:
    """Run the child process: load and test the description, and send the result to `writer`. Drops everything that the
    description prints. Never returns, and skips the exit handlers that the child has inherited."""
    try:
        os.setsid()
        _signal.signal(_signal.SIGALRM, _signal.SIG_DFL)
        _signal.alarm(int(LIMIT_S) + 1)  # its parent may be killed meanwhile
        nowhere = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, 2):
            os.dup2(nowhere, fd)
        sys.stdout = sys.stderr = os.fdopen(nowhere, "w")
        try:
            found = _load(folder, name, value)
            said = _complaint(folder, found) if value == "WIRE" else ""
        except OwnBoardError as error:
            said = error.what
        except (Exception, SystemExit) as error:
            said = f"{folder}/{name}.py: {type(error).__name__}: {error}"
        os.write(writer, _SOUND + said.encode("utf-8", "replace")[: select.PIPE_BUF - 1])
    finally:
        os._exit(0)


def _complaint(folder: str, found: object) -> str:
    from failstop.board import sound
    from failstop.board.wire import Wire

    if not isinstance(found, Wire):
        return ""  # wire() reports it
    wrong = sound.wrong(found)
    return f"{folder}/wire.py: {wrong}" if wrong else ""


def _heard(reader: int, until_s: float) -> bytes | None:
    """Return the child's report. Empty if the child ended without a report. None if the child neither reported nor
    ended before `until_s` (time.monotonic())."""
    left_s = until_s - time.monotonic()
    if not select.select([reader], [], [], max(0.0, left_s))[0]:
        return None
    return os.read(reader, select.PIPE_BUF)


def _ended(child: int) -> str:
    """Kill the child and everything that it has started, and wait for its end. Returns how it ended, in words."""
    try:
        os.killpg(child, _SIGKILL)
    except OSError:
        _kill(child)  # it has no session of its own yet
    try:
        _, status = os.waitpid(child, 0)
    except ChildProcessError:  # inherited from a parent that ignores the ends of its children
        return ""
    code = os.waitstatus_to_exitcode(status)
    return f" (signal {-code})" if code < 0 else f" (exit code {code})"


def _kill(child: int) -> None:
    try:
        os.kill(child, _SIGKILL)
    except OSError:
        return


# Modules are loaded only from source, through the descriptor that was checked.


class _Modules:
    """Imports the modules of one folder, from their source files only. Python asks no other finder for these modules.
    So it never imports an extension, a subfolder, or a compiled copy of a source."""

    def __init__(self) -> None:
        self.folder = ""
        self.tried: set[str] = set()
        """The modules that a child process has already loaded."""

    def find_spec(self, name: str, _path: object = None, _target: object = None) -> ModuleSpec | None:
        package, _, module = name.partition(".")
        if package != OWN_PACKAGE or not module:
            return None
        place = os.path.join(self.folder, f"{module}.py")
        if "." in module or not os.path.lexists(place):
            raise ModuleNotFoundError(f"No module named {module!r} in {self.folder}", name=name)
        spec: ModuleSpec = type(sys.__spec__)(name, self, origin=place)  # type: ignore[arg-type]
        spec.has_location = True
        return spec

    def create_module(self, _spec: ModuleSpec) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        place = str(module.__file__)
        exec(compile(_source(place), place, "exec", dont_inherit=True), vars(module))


_FINDER = _Modules()


def _modules(folder: str) -> _Modules:
    """Set _FINDER to this folder, and return it. _FINDER imports the folder's modules. The modules of any other folder
    are unloaded, because a process uses only one such folder at a time."""
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)
    if _FINDER.folder != folder or OWN_PACKAGE not in sys.modules:
        for name in [name for name in sys.modules if name.partition(".")[0] == OWN_PACKAGE]:
            del sys.modules[name]
        package = sys.modules[OWN_PACKAGE] = type(sys)(OWN_PACKAGE)
        package.__path__ = []
        _FINDER.folder, _FINDER.tried = folder, set()
    return _FINDER


def _source(path: str) -> bytes:
    """Return the bytes of a file that no other user may write. Raises OwnBoardError."""
    found, info = _open(path)
    try:
        if not stat.S_ISREG(info.st_mode):
            raise OwnBoardError(f"{path} is {_what(info)}, must be a file")
        if info.st_size > _MOST_BYTES:
            raise OwnBoardError(f"{path} has {info.st_size} bytes, must have {_MOST_BYTES} at most")
        reading = os.open(f"/proc/self/fd/{found}", os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise OwnBoardError(f"{path}: {error.strerror}") from None
    finally:
        os.close(found)
    try:
        _check_one(os.fstat(reading), path)
        data = b""
        while len(data) <= _MOST_BYTES and (part := os.read(reading, _MOST_BYTES + 1 - len(data))):
            data += part
        return data
    finally:
        os.close(reading)


def _open(path: str) -> tuple[int, os.stat_result]:
    """Return a descriptor and the status of the file or folder at a full path. Each folder and link on the way is
    opened without following links, and checked through its own descriptor. So nobody can exchange it after the check.
    Raises OwnBoardError."""
    here, at, links = os.open("/", os.O_PATH | os.O_CLOEXEC), "/", 0
    left = path.split("/")[::-1]
    info = os.fstat(here)
    try:
        while left:
            name = left.pop()
            if name in ("", "."):
                continue
            at, above = os.path.normpath(os.path.join(at, name)), at
            found = os.open(name, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=here)
            info = os.fstat(found)
            target = os.readlink("", dir_fd=found) if stat.S_ISLNK(info.st_mode) else ""
            if target:
                os.close(found)
                links, at, left = links + 1, above, left + target.split("/")[::-1]
                _check_one(info, os.path.join(above, name))
                found, at = (os.open("/", os.O_PATH | os.O_CLOEXEC), "/") if target[0] == "/" else (os.dup(here), at)
            os.close(here)
            here = found
            if links > _MOST_LINKS:
                raise OwnBoardError(f"{path} leads through too many links")
            if not target:
                _check_one(info, at, on_the_way=bool(left))
    except OSError as error:
        os.close(here)
        raise OwnBoardError(f"{at}: {error.strerror}") from None
    except OwnBoardError:
        os.close(here)
        raise
    return here, info


def _check(folder: str) -> None:
    """Raise OwnBoardError if another user may change the folder, anything in it, or any folder or link on its path.
    Also raised for special files, links to anything but a file, compiled modules outside of `__pycache__`, and more
    than _MOST_FILES entries."""
    fd, info = _open(folder)
    try:
        if not stat.S_ISDIR(info.st_mode):
            raise OwnBoardError(f"{folder} is {_what(info)}, must be a folder")
        for count, (path, each) in enumerate(_everything(fd, folder), 1):
            _check_one(each, path)
            if stat.S_ISLNK(each.st_mode):
                led, each = _open(path)
                os.close(led)
                if not stat.S_ISREG(each.st_mode):
                    raise OwnBoardError(f"{path} leads to {_what(each)}, must lead to a file: rm {path}")
            elif not (stat.S_ISREG(each.st_mode) or stat.S_ISDIR(each.st_mode)):
                raise OwnBoardError(f"{path} is {_what(each)}, must be a file: rm {path}")
            if path.endswith(_COMPILED) and os.path.basename(os.path.dirname(path)) != "__pycache__":
                raise OwnBoardError(f"{path} is compiled, and only source is imported: rm {path}")
            if count > _MOST_FILES:
                raise OwnBoardError(f"{folder} holds more than {_MOST_FILES} files: keep the board's own alone in it")
    except OSError as error:
        raise OwnBoardError(f"{folder}: {error.strerror}") from None
    finally:
        os.close(fd)


def _everything(fd: int, folder: str) -> Iterator[tuple[str, os.stat_result]]:
    """Yield everything in a folder and in its subfolders: (path, status)."""
    listed = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=fd)
    try:
        for name in sorted(os.listdir(listed)):
            path = os.path.join(folder, name)
            info = os.stat(name, dir_fd=listed, follow_symlinks=False)
            yield path, info
            if stat.S_ISDIR(info.st_mode):
                below = os.open(name, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=listed)
                try:
                    yield from _everything(below, path)
                finally:
                    os.close(below)
    finally:
        os.close(listed)


def _check_one(found: os.stat_result, path: str, *, on_the_way: bool = False) -> None:
    """Raise OwnBoardError unless this file or folder belongs to root or to this process's user, and nobody but its
    owner may write it (place.by_others())."""
    if found.st_uid not in (0, os.geteuid()):
        raise OwnBoardError(f"{path} belongs to another user: sudo chown {'-h ' * _is_link(found)}root {path}")
    if place.by_others(found, on_the_way=on_the_way):
        raise OwnBoardError(f"others may write {path}: sudo chmod go-w {path}")


def _is_link(found: os.stat_result) -> bool:
    return stat.S_ISLNK(found.st_mode)


def _what(found: os.stat_result) -> str:
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a FIFO", stat.S_IFSOCK: "a socket", stat.S_IFREG: "a file"}
    return kinds.get(stat.S_IFMT(found.st_mode), "a device")
