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


def build(directory: Path, out: Path, interpreter: str) -> list[Path]:
    """Lay the packages out in a directory and pack them; returns their paths, the robot's first."""
    whole = tree.running(PREFIX, interpreter, [extra.needs for extra in EXTRAS if extra.needs])
    inside = [entry for entry in whole.entries if entry.path.startswith(LAB)]
    scripts = {f"DEBIAN/{name}": script(name) for name in SCRIPTS} | {"DEBIAN/conffiles": f"/{CONFIGURATION}\n"}
    layouts = {
        "failstop": ([entry for entry in whole.entries if entry not in inside], files(rows.texts()) | scripts),
        LABORATORY: (inside, papers(LABORATORY)),
    }
    packed = []
    for name, (entries, texts) in layouts.items():
        root = directory / name
        (root / "opt").mkdir(parents=True)
        dataclasses.replace(whole, entries=tuple(entries)).write(str(root / PREFIX.lstrip("/")))
        for path, text in texts.items():
            _write(root / path, text)
        if name != LABORATORY:
            (root / "usr/bin").mkdir(parents=True)
            (root / "usr/bin/failstop").symlink_to(f"{PREFIX}/bin/failstop")
        _control(root, name, os.path.basename(interpreter))
        for folder, _, _ in os.walk(root):
            os.chmod(folder, 0o755)
        # gzip: much faster than xz, and every dpkg reads it. The directory as target: dpkg-deb names the file.
        said = _said("dpkg-deb", "--root-owner-group", "-Zgzip", "-z4", "--build", str(root), str(out))
        packed.append(out / os.path.basename(said.split("'")[-2]))
    return packed


def papers(package: str) -> dict[str, str]:
    """What Debian wants to see in each package, by path."""
    licences = f"\nThe packages below {PREFIX} have licences of their own, in their .dist-info directories.\n"
    return {
        f"usr/share/doc/{package}/changelog.gz": changelog(package),
        f"usr/share/doc/{package}/copyright": (CHECKOUT / "LICENSE").read_text() + licences,
    }


def files(texts: Mapping[str, str]) -> dict[str, str]:
    """The texts of the robot's package but for the environment, by path; compressed where it ends in .gz."""
    placed = {row.package.lstrip("/"): texts[row.source] for row in ROWS}
    return {CONFIGURATION: texts[SETTINGS]} | placed | papers("failstop")


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


def changelog(package: str) -> str:
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


def _control(root: Path, package: str, python: str) -> None:
    """DEBIAN/: the control file from its template, and the checksums."""
    regular = sorted(path for path in root.rglob("*") if path.is_file() and not path.is_symlink())
    regular = [path for path in regular if path.parent.name != "DEBIAN"]
    words = {
        "version": VERSION,
        "maintainer": maintainer(os.environ),
        "installed_kib": sum(path.stat().st_size for path in regular) // 1024 + 1,
        "architecture": _said("dpkg", "--print-architecture"),
        "python": python,
        "libc": newest_libc(root),
    }
    _write(root / "DEBIAN/control", (HERE / f"{package}.control").read_text().format(**words))
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(root)}\n" for path in regular]
    _write(root / "DEBIAN/md5sums", "".join(line for line in sums if not line.endswith(f"{CONFIGURATION}\n")))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = text.encode()
    path.write_bytes(gzip.compress(data, 9, mtime=0) if path.suffix == ".gz" else data)
    os.chmod(path, 0o755 if path.name in SCRIPTS else 0o644)


def _said(*words: str) -> str:
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
