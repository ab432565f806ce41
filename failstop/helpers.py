"""Helpers: the Python processes that a command starts. They import the same modules as the command, but never a module
from the current folder.

`python -m failstop` puts the current folder first on the search path, and so does an empty entry of PYTHONPATH. If root
runs failstop in a folder with another user's `json.py`, Python would run that file as root. Python's option `-P` exists
only since 3.11. `-I` alone would also ignore PYTHONPATH and the user's site-packages, where ROS and failstop may be
installed. So a helper starts with `-I` and runs this file, and its parent passes the search path.

A library that reads a settings file from the current folder is imported with import_elsewhere().
"""

from __future__ import annotations

import os
import sys

_FILE = os.path.abspath(__file__)
_PACKAGE = os.path.dirname(_FILE)


def python(module: str, *words: str) -> list[str]:
    """The command line of a helper that runs a module, or the program `words[0]` if `module` is "-c"."""
    flags = ["-I", *["-B"] * sys.dont_write_bytecode]
    return [sys.executable, *flags, _FILE, os.pathsep.join(search_path()), module, *words]


def search_path() -> list[str]:
    """This process's search path without the current folder and relative folders. The current folder stays if
    PYTHONPATH has its full path, or if Python, failstop or installed packages are in it."""
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    meant = {os.path.dirname(_PACKAGE), os.path.dirname(os.__file__), *filter(os.path.isabs, named), *_site_packages()}
    try:
        here = os.getcwd()
        left_out = {here, *(os.path.abspath(path) for path in named if not os.path.isabs(path))} - meant
    except OSError:  # the current folder was removed, so nothing can be imported from it
        left_out = set()
    # A new Python process would use today's PYTHONPATH, which may have changed since this process started.
    since = [path for path in named if path not in sys.path]
    found = dict.fromkeys(path for path in (*since, *sys.path) if os.path.isabs(path) and path not in left_out)
    return [*found, *{os.path.dirname(_PACKAGE)} - found.keys()]


def _site_packages() -> list[str]:
    """The folders in which pip and the Linux distribution install packages."""
    site = sys.modules.get("site")
    return [*site.getsitepackages(), site.getusersitepackages()] if site and not sys.flags.no_site else []


def leave_current_folder() -> None:
    """From now on, import nothing from the current folder in this process. Child processes inherit a PYTHONPATH without
    relative folders."""
    sys.path[:] = search_path()
    if named := os.environ.get("PYTHONPATH"):
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(os.path.isabs, named.split(os.pathsep)))


def import_elsewhere(module: str) -> None:
    """Import a module that reads a settings file from the current folder when it is imported, as matplotlib does. The
    current folder is / meanwhile, where only root has files. Raises ImportError."""
    from importlib import import_module

    try:
        here = os.open(".", os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    except PermissionError:  # then nothing in it can be read either
        import_module(module)
        return
    try:
        os.chdir("/")
        import_module(module)
    finally:
        os.fchdir(here)
        os.close(here)


def _main(path: str, module: str, *words: str) -> None:
    sys.path[:] = path.split(os.pathsep)
    sys.argv = [module, *words]
    if module == "-c":
        sys.argv = [module, *words[1:]]
        exec(compile(words[0], "<string>", "exec"), {"__name__": "__main__"})
    else:
        import runpy

        runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    _main(*sys.argv[1:])
