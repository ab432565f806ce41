"""Loading: the service's own modules, as they ship, on a simulated machine.

Each is executed once more with an `__import__` of its own: failstop's modules are loaded here too, those that speak
with the kernel are the machine's (system.py), and the rest is Python's. So a call that is not simulated is an error at
once, and the code under test needs no seam of its own.
"""

from __future__ import annotations

import builtins
import functools
import importlib
import importlib.util
import os
import sys
from importlib.machinery import SourceFileLoader
from types import CodeType, ModuleType
from typing import Any

import failstop
from failstop_lab.machine.calls import Calls
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.stand_ins import stand_ins
from failstop_lab.machine.system import modules

HOME = os.path.dirname(os.path.abspath(failstop.__file__))
HARMLESS = {
    *(
        "__future__",
        "abc",
        "argparse",
        "asyncio",
        "binascii",
        "bisect",
        "collections",
        "contextlib",
        "copy",
        "dataclasses",
    ),
    *(
        "difflib",
        "enum",
        "errno",
        "functools",
        "heapq",
        "itertools",
        "json",
        "math",
        "msgpack",
        "operator",
        "re",
        "shlex",
    ),
    *("stat", "string", "struct", "textwrap", "tomli", "tomllib", "types", "typing", "unicodedata", "warnings"),
    "zlib",
}
"""Modules that ask no machine: Python's own, and those of a tool that changes what is loaded."""
SHARED_MODULES = frozenset(
    f"failstop.{name}"
    for name in (
        *("data", "messages.box", "messages.records"),
        *(f"policy.{each}" for each in ("capsules", "causes", "joints", "kinematics", "layouts")),
        *(f"policy.{each}" for each in ("processes", "proofs", "robots")),
        *("policy.setting", "policy.settings"),
        *(f"board.{each}" for each in ("checks", "facts", "lines", "servos", "wire")),
        *(f"board.rrc.{each}" for each in ("burst", "codec", "decoder", "framing")),
    )
)
"""Modules that ask no machine and import none that does: each machine has this process's own, which are loaded once."""
_CODE: dict[str, tuple[CodeType, bool]] = {}


Patches = tuple[tuple[str, str, str], ...]
"""Changes of the code that is loaded: the module, a piece of its source that is there once, and what stands in its
place."""


def patched(name: str, source: str, patches: Patches) -> str:
    """The changed source of a module. Raises ValueError for a patch of what is not there once."""
    for module, old, new in patches:
        if module == name:
            if source.count(old) != 1:
                raise ValueError(f"{name} has {source.count(old)} times {old!r}, not once")
            source = source.replace(old, new)
    return source


def _compiled(name: str, patches: Patches = ()) -> tuple[CodeType, bool]:
    """A module's code, and whether it is a package. Raises ValueError for a patch of what is not there."""
    path = os.path.join(HOME, *name.split(".")[1:])
    package = os.path.isdir(path)
    path = os.path.join(path, "__init__.py") if package else f"{path}.py"
    if any(module == name for module, _, _ in patches):
        with open(path, encoding="utf-8") as file:
            return compile(patched(name, file.read(), patches), path, "exec"), package
    if name not in _CODE:
        # Python's own loader: it takes the compiled copy that is kept beside the source.
        code = SourceFileLoader(name, path).get_code(name)
        assert code is not None
        _CODE[name] = code, package
    return _CODE[name]


class Loader:
    """The modules of one simulated machine."""

    def __init__(self, machine: Machine, patches: Patches = ()) -> None:
        self.machine = machine
        self._patches = patches
        self._shared = SHARED_MODULES if SHARED_MODULES.isdisjoint(module for module, _, _ in patches) else frozenset()
        calls = Calls(machine)
        self.system = modules(calls)
        """The simulated modules, by name."""
        self._loaded: dict[str, ModuleType] = stand_ins(calls)
        self._unnamed = set(self._loaded)
        """Stand-ins that their package does not know yet."""
        self._builtins = {**vars(builtins), "__import__": self._import, "open": self._open, "print": self._print}
        self._builtins["__build_class__"] = self._build_class

    def load(self, name: str) -> Any:
        """A module of failstop's by its name."""
        if name in self._loaded and name not in self._unnamed:
            return self._loaded[name]
        above, _, last = name.rpartition(".")
        parent = self.load(above) if above else None
        if name in self._unnamed:
            self._unnamed.discard(name)
            setattr(parent, last, self._loaded[name])
        if name in self._loaded:
            return self._loaded[name]
        if name in self._shared:
            shared = self._loaded[name] = importlib.import_module(name)
            setattr(parent, last, shared)
            return shared
        code, package = _compiled(name, self._patches)
        module = ModuleType(name)
        module.__dict__.update(
            __builtins__=self._builtins, __file__=code.co_filename, __package__=name if package else above
        )
        if package:
            module.__path__ = [os.path.dirname(code.co_filename)]
        self._loaded[name] = module
        # dataclasses looks a class's module up there.
        before, sys.modules[name] = sys.modules.get(name), module
        try:
            exec(code, module.__dict__)
        except BaseException:
            del self._loaded[name]
            raise
        finally:
            if before is None:
                del sys.modules[name]
            else:
                sys.modules[name] = before
        if parent is not None:
            setattr(parent, last, module)
        return module

    def loaded(self) -> list[str]:
        """The names of all modules that there are by now, in the order of their loading."""
        return list(self._loaded)

    def _import(self, name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
        top = name.partition(".")[0]
        if top == "failstop":
            module = self.load(name)
            for each in fromlist or ():
                if not hasattr(module, each) and _exists(f"{name}.{each}"):
                    self.load(f"{name}.{each}")
            return module if fromlist else self.load("failstop")
        if top in self.system:
            return self.system[name if fromlist else top]
        if top in HARMLESS:
            return builtins.__import__(name, globals, locals, fromlist, level)
        raise ImportError(f"the simulated machine has no {name}")

    def _build_class(self, *arguments: Any, **options: Any) -> Any:
        made = builtins.__build_class__(*arguments, **options)
        if "__del__" in vars(made):
            made.__del__ = self.machine.finalizer(made.__del__)
        return made

    def _print(self, *values: object, **options: Any) -> None:
        builtins.print(*values, **{"file": self.system["sys"].stdout, **options})

    def _open(self, path: Any, mode: str = "r", *_: Any, opener: Any = None, **__: Any) -> Any:
        return File(self.system["os"], path, mode, opener)


@functools.cache
def _exists(name: str) -> bool:
    if name in sys.modules:
        return True
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


class File:
    """A file as open() returns it: bytes or text of a file."""

    def __init__(self, system: Any, path: Any, mode: str, opener: Any) -> None:
        flags = os.O_RDONLY if "r" in mode else os.O_WRONLY | os.O_CREAT | (os.O_EXCL if "x" in mode else os.O_TRUNC)
        self.system, self._text = system, "b" not in mode
        self._fd: int
        if isinstance(path, int):
            self._fd = path
        else:
            self._fd = opener(path, flags) if opener else system.open(path, flags)

    def fileno(self) -> int:
        return self._fd

    def read(self, most: int = 1 << 30) -> Any:
        data = self.system.read(self._fd, most)
        return data.decode() if self._text else data

    def readline(self, most: int = 1 << 30) -> Any:
        return self.read(most).partition("\n")[0]

    def __iter__(self) -> Any:
        return iter(self.read().splitlines(keepends=True))

    def write(self, data: Any) -> int:
        written: int = self.system.write(self._fd, data.encode() if self._text else data)
        return written

    def flush(self) -> None:
        return None

    def close(self) -> None:
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            self.system.close(fd)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
