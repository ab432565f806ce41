"""Commands that can be pasted: the judgements write `failstop` and `sudo`; here they get what this shell needs."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Mapping

SUDO_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
"""As sudo has it on Debian and Ubuntu (secure_path), whatever the user's is."""
_OWN = re.compile(r"(?<![\w/.'@-])failstop (?=[a-z-]+)")
_AS_ROOT = re.compile(r"(?<![\w/.'@-])sudo failstop (?=[a-z-]+)")


def commands(environ: Mapping[str, str]) -> tuple[str, str]:
    """How this failstop is called: (from this shell, by way of sudo)."""
    own = os.path.join(os.path.dirname(sys.executable), "failstop")
    if not os.access(own, os.X_OK):
        own = f"{sys.executable} -m failstop"
    return _called(own, environ.get("PATH", "")), _called(own, SUDO_PATH)


def _called(own: str, path: str) -> str:
    found = shutil.which("failstop", path=path)
    same = found and os.path.realpath(found) == os.path.realpath(own.partition(" ")[0])
    return "failstop" if same else own


def ready(fix: str, shell: str, sudo: str, *, root: bool) -> str:
    """The command with the program named so that it is found, and for root without sudo. Pure."""
    if root:
        return _OWN.sub(f"{shell} ", fix.replace("sudo ", ""))
    first = _AS_ROOT.sub("sudo \0 ", fix)
    return _OWN.sub(f"{shell} ", first).replace("\0", sudo)
