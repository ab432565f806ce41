"""Build the Debian package with dpkg-deb: `python packaging/deb/build.py [--out DIR]`, run by the environment to pack.

The package holds the Python environment that `failstop install` would make, for the system's interpreter of the running
version, and the files of systemd/ in the places that belong to packages.
"""

from __future__ import annotations

import argparse
import email.utils
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from failstop.install import InstallError, parts, tree
from failstop.install.layout import PREFIX

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent.parent
SCRIPTS = ("preinst", "postinst", "prerm", "postrm")
CONFIGURATION = "etc/failstop/failstop.toml"
NOBODY = "failstop developers <root@localhost>"
DOC = "usr/share/doc/failstop"
COMPLETIONS = {
    "bash": "usr/share/bash-completion/completions/failstop",
    "zsh": "usr/share/zsh/vendor-completions/_failstop",
    "fish": "usr/share/fish/vendor_completions.d/failstop.fish",
}


def main() -> int:
    """Build it and print its path."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=CHECKOUT / "dist", help="the directory for it (default: dist)")
    arguments = parser.parse_args()
    interpreter = f"/usr/bin/{tree.PYTHON}"
    if problem := tree.unreachable(interpreter):
        advice = "use the system's Python: make deb PYTHON=/usr/bin/python3 VENV=.venv-deb"
        print(f"failstop: the package is for the system's {interpreter}: {problem}; {advice}", file=sys.stderr)
        return 1
    arguments.out.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(prefix="failstop-deb-") as directory:
            print(build(Path(directory) / "root", arguments.out, interpreter))
    except InstallError as error:
        print(f"failstop: {error}", file=sys.stderr)
        return 1
    return 0


def build(root: Path, out: Path, interpreter: str) -> Path:
    """Lay the package out in a new directory and pack it; returns the package's path."""
    brought = parts.of_this_version()
    (root / "opt").mkdir(parents=True)
    tree.running(PREFIX, interpreter).write(str(root / PREFIX.lstrip("/")))
    for path, text in files(brought).items():
        _write(root / path, text.encode())
    _write_compressed(root / DOC / "changelog.gz", changelog(brought.version))
    _write_compressed(root / "usr/share/man/man1/failstop.1.gz", brought.manual)
    (root / "usr/bin").mkdir(parents=True)
    (root / "usr/bin/failstop").symlink_to(f"{PREFIX}/bin/failstop")
    for folder, _, _ in os.walk(root):
        os.chmod(folder, 0o755)
    architecture = _said("dpkg", "--print-architecture")
    _control(root, brought.version, architecture, os.path.basename(interpreter))
    package = out / f"failstop_{brought.version}_{architecture}.deb"
    # gzip: much faster than xz, and every dpkg reads it.
    _said("dpkg-deb", "--root-owner-group", "-Zgzip", "-z4", "--build", str(root), str(package))
    return package


def files(brought: parts.Parts) -> dict[str, str]:
    """The texts of the package but for the environment, by path."""
    return {
        CONFIGURATION: brought.example,
        **{f"usr/lib/systemd/system/{name}": text for name, text in brought.units.items()},
        "usr/lib/systemd/system/failstop-ros2.service": brought.bridge,
        "usr/lib/sysusers.d/failstop.conf": brought.sysusers,
        "usr/lib/udev/rules.d/90-failstop.rules": brought.udev,
        "usr/lib/systemd/catalog/failstop.catalog": brought.catalog,
        **{path: brought.completions[shell] for shell, path in COMPLETIONS.items()},
        f"{DOC}/copyright": (CHECKOUT / "LICENSE").read_text()
        + f"\nThe packages below {PREFIX} have licences of their own, in their .dist-info directories.\n",
    }


def maintainer(environ: Mapping[str, str], folder: Path = CHECKOUT) -> str:
    """Who answers for this package: DEBFULLNAME and DEBEMAIL, as Debian's tools have it, else git's user, or nobody."""
    name, mail = environ.get("DEBFULLNAME") or _git("user.name", folder), environ.get("DEBEMAIL")
    mail = mail or _git("user.email", folder)
    return f"{name} <{mail}>" if name and mail else NOBODY


def _git(key: str, folder: Path) -> str:
    try:
        done = subprocess.run(["git", "-C", str(folder), "config", key], capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip()


def changelog(version: str) -> str:
    """What Debian wants to see of a version."""
    who = maintainer(os.environ)
    date = email.utils.formatdate(int(os.environ.get("SOURCE_DATE_EPOCH", time.time())))
    return f"failstop ({version}) unstable; urgency=medium\n\n  * Version {version}.\n\n -- {who}  {date}\n"


def newest_libc(root: Path) -> str:
    """The newest version of glibc that a compiled module asks for."""
    found = {(2, 17)}
    for path in root.rglob("*.so*"):
        found |= {(2, int(minor)) for minor in re.findall(rb"GLIBC_2\.(\d+)", path.read_bytes())}
    return "{}.{}".format(*max(found))


def _control(root: Path, version: str, architecture: str, python: str) -> None:
    """DEBIAN/: control, checksums, the list of configuration files, the scripts."""
    regular = sorted(path for path in root.rglob("*") if path.is_file() and not path.is_symlink())
    (root / "DEBIAN").mkdir(mode=0o755)
    control = (
        (HERE / "control.in")
        .read_text()
        .format(
            version=version,
            architecture=architecture,
            maintainer=maintainer(os.environ),
            installed_kib=sum(path.stat().st_size for path in regular) // 1024 + 1,
            python=python,
            libc=newest_libc(root),
        )
    )
    _write(root / "DEBIAN/control", control.encode())
    _write(root / "DEBIAN/conffiles", f"/{CONFIGURATION}\n".encode())
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(root)}\n" for path in regular]
    _write(root / "DEBIAN/md5sums", "".join(line for line in sums if not line.endswith(f"{CONFIGURATION}\n")).encode())
    for name in SCRIPTS:
        shutil.copyfile(HERE / name, root / "DEBIAN" / name)
        os.chmod(root / "DEBIAN" / name, 0o755)


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    os.chmod(path, 0o644)


def _write_compressed(path: Path, text: str) -> None:
    _write(path, gzip.compress(text.encode(), 9, mtime=0))


def _said(*words: str) -> str:
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
