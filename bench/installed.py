"""This very failstop, as installed at /opt/failstop of a container: nothing is copied, nothing built.

The unit's sandbox hides home directories, where an interpreter of pyenv's or a checkout may live, so everything has a
place of its own in there: the interpreter below /opt/python, the checkout and its dependencies below /opt/failstop.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path

from bench.container import Bind

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PREFIX = "/opt/failstop"
PYTHON = "/opt/python"
SYSTEM = "/usr"
COMMAND = f"""#!{PREFIX}/bin/python3
import sys
sys.path.insert(0, "{PREFIX}/src")
from failstop.cli.main import main
sys.exit(main())
"""
SYSTEMD = Path(ROOT, "systemd")
SYSUSERS = "/etc/sysusers.d/failstop.conf"


def lay_out(directory: Path) -> list[Bind]:
    """Write what an installation needs into `directory`; returns what a container must have of the machine for it."""
    version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    packages = Path("lib", version, "site-packages")
    base = os.path.realpath(sys.base_prefix)
    python = base if base == SYSTEM else PYTHON
    for name in ("bin", "src", packages):
        (directory / name).mkdir(parents=True)
    (directory / "pyvenv.cfg").write_text(f"home = {python}/bin\ninclude-system-site-packages = false\n")
    (directory / "bin" / "python3").symlink_to(f"{python}/bin/{version}")
    command = directory / "bin" / "failstop"
    command.write_text(COMMAND)
    command.chmod(0o755)
    directory.chmod(0o755)
    binds = [
        Bind(str(directory), PREFIX),
        Bind(ROOT, f"{PREFIX}/src"),
        Bind(sysconfig.get_path("purelib"), f"{PREFIX}/{packages}"),
        Bind(str(SYSTEMD / "failstop.sysusers"), SYSUSERS),
    ]
    if base != SYSTEM:
        binds.append(Bind(base, PYTHON))
        if library := _shared_library(base):
            # Where the dynamic linker looks when the path that was built in is hidden.
            binds.append(Bind(library, f"/usr/lib/{os.path.basename(library)}"))
    return binds


def _shared_library(base: str) -> str:
    """The interpreter's library, if it is not all in one file."""
    name = str(sysconfig.get_config_var("INSTSONAME") or "")
    path = os.path.join(base, "lib", name)
    return path if ".so" in name and os.path.exists(path) else ""


def units() -> dict[str, str]:
    """The text of each unit by its name, as it is installed."""
    return {path.name: path.read_text(encoding="utf-8") for path in sorted(SYSTEMD.glob("*.service"))}
