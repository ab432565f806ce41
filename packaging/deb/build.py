"""Build the Debian packages with dpkg-deb: `python packaging/deb/build.py [--out DIR]`, run by the environment to pack.

The package failstop holds the Python environment that `failstop install` would make, for the system's interpreter of
the running version, and the files of systemd/ in the places that belong to packages. failstop-lab adds the laboratory.
"""

from __future__ import annotations

import argparse
import dataclasses
import email.utils
import gzip
import hashlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from failstop import config
from failstop.install import InstallError, rows, system, tree
from failstop.install.rows import EXTRAS, LATE, OWN, ROWS, SETTINGS
from failstop.install.system import PREFIX
from failstop.shm.instance import DEFAULT_NAME
from failstop.version import VERSION

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent.parent
SCRIPTS = ("preinst", "postinst", "prerm", "postrm")
CONFIGURATION = config.file_of(DEFAULT_NAME).lstrip("/")
LABORATORY = "failstop-lab"
LAB = f"{tree.SITE}/failstop/lab/"
NOBODY = "failstop developers <root@localhost>"
DOC = "usr/share/doc/failstop"
WORDS = {
    "@BOOT@": " ".join(row.source for row in OWN if row.boot),
    "@EXTRAS@": " ".join(extra.source for extra in EXTRAS),
    "@LATE@": LATE.replace("@", "@*"),
    "@SYSUSERS@": next(row.package for row in ROWS if row.place == rows.SYSUSERS),
    "@CONFIGURATION@": config.FOLDER,
    "@STATE@": system.STATE,
    "@RUNTIME@": system.RUNTIME,
    "@MANIFEST@": system.MANIFEST,
}
"""What the scripts of the package say of the installation's rows and places."""


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
            for package in build(Path(directory), arguments.out, interpreter):
                print(package)
    except InstallError as error:
        print(f"failstop: {error}", file=sys.stderr)
        return 1
    return 0


def build(directory: Path, out: Path, interpreter: str) -> tuple[Path, Path]:
    """Lay the packages out in a directory and pack them; returns their paths."""
    whole = tree.running(PREFIX, interpreter, [extra.needs for extra in EXTRAS if extra.needs])
    inside = {entry for entry in whole.entries if entry.path.startswith(LAB)}
    robots = dataclasses.replace(whole, entries=tuple(entry for entry in whole.entries if entry not in inside))
    laboratory = dataclasses.replace(whole, entries=tuple(inside))
    return (
        _robots(robots, directory / "failstop", out),
        _laboratory(laboratory, directory / "failstop-lab", out),
    )


def _robots(environment: tree.Environment, root: Path, out: Path) -> Path:
    (root / "opt").mkdir(parents=True)
    environment.write(str(root / PREFIX.lstrip("/")))
    for path, text in files(rows.texts()).items():
        _write(root / path, text)
    (root / "usr/bin").mkdir(parents=True)
    (root / "usr/bin/failstop").symlink_to(f"{PREFIX}/bin/failstop")
    _control(
        root,
        "control.in",
        architecture=_said("dpkg", "--print-architecture"),
        python=os.path.basename(environment.interpreter),
        libc=newest_libc(root),
    )
    _write(root / "DEBIAN/conffiles", f"/{CONFIGURATION}\n")
    for name in SCRIPTS:
        _write(root / "DEBIAN" / name, script(name))
        os.chmod(root / "DEBIAN" / name, 0o755)
    return _packed(root, out)


def _laboratory(environment: tree.Environment, root: Path, out: Path) -> Path:
    (root / "opt").mkdir(parents=True)
    environment.write(str(root / PREFIX.lstrip("/")))
    _write(root / f"usr/share/doc/{LABORATORY}/copyright", (CHECKOUT / "LICENSE").read_text())
    _write(root / f"usr/share/doc/{LABORATORY}/changelog.gz", changelog(LABORATORY))
    _control(root, "control-lab.in", architecture="all")
    return _packed(root, out)


def _packed(root: Path, out: Path) -> Path:
    for folder, _, _ in os.walk(root):
        os.chmod(folder, 0o755)
    # gzip: much faster than xz, and every dpkg reads it. The directory as target: dpkg-deb names the file.
    said = _said("dpkg-deb", "--root-owner-group", "-Zgzip", "-z4", "--build", str(root), str(out))
    return out / os.path.basename(said.split("'")[-2])


def files(texts: Mapping[str, str]) -> dict[str, str]:
    """The texts of the package but for the environment, by path; compressed where it ends in .gz."""
    return {
        CONFIGURATION: texts[SETTINGS],
        **{row.package.lstrip("/"): texts[row.source] for row in ROWS},
        f"{DOC}/changelog.gz": changelog(),
        f"{DOC}/copyright": (CHECKOUT / "LICENSE").read_text()
        + f"\nThe packages below {PREFIX} have licences of their own, in their .dist-info directories.\n",
    }


def script(name: str) -> str:
    """A script of the package, with the rows' words in it."""
    text = (HERE / name).read_text()
    for word, meaning in WORDS.items():
        text = text.replace(word, meaning)
    return text


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


def changelog(package: str = "failstop") -> str:
    """What Debian wants to see of a version."""
    who = maintainer(os.environ)
    date = email.utils.formatdate(int(os.environ.get("SOURCE_DATE_EPOCH", time.time())))
    return f"{package} ({VERSION}) unstable; urgency=medium\n\n  * Version {VERSION}.\n\n -- {who}  {date}\n"


def newest_libc(root: Path) -> str:
    """The newest version of glibc that a compiled module asks for."""
    found = {(2, 17)}
    for path in root.rglob("*.so*"):
        found |= {(2, int(minor)) for minor in re.findall(rb"GLIBC_2\.(\d+)", path.read_bytes())}
    return "{}.{}".format(*max(found))


def _control(root: Path, template: str, **words: str) -> None:
    """DEBIAN/: the control file from its template, and the checksums."""
    regular = sorted(path for path in root.rglob("*") if path.is_file() and not path.is_symlink())
    size = sum(path.stat().st_size for path in regular) // 1024 + 1
    control = (
        (HERE / template)
        .read_text()
        .format(version=VERSION, maintainer=maintainer(os.environ), installed_kib=size, **words)
    )
    _write(root / "DEBIAN/control", control)
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(root)}\n" for path in regular]
    _write(root / "DEBIAN/md5sums", "".join(line for line in sums if not line.endswith(f"{CONFIGURATION}\n")))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = text.encode()
    path.write_bytes(gzip.compress(data, 9, mtime=0) if path.suffix == ".gz" else data)
    os.chmod(path, 0o644)


def _said(*words: str) -> str:
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
