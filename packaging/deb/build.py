"""Build the Debian packages with dpkg-deb: `python packaging/deb/build.py [--out DIR]`, run by the environment to pack.

The package failstop holds a Python environment (tree.py), the files of systemd/, and the man page and completions of
the command line. failstop-lab adds the laboratory, libfailstop0 and libfailstop-dev the C library (c_library.py).
Packed from the running environment, they are for its Python alone;
with --sites they are for every Python that has a folder there, so one package installs on Debian 12 as well as on 13.
"""

from __future__ import annotations

import argparse
import email.utils
import gzip
import hashlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import c_library
import sbom
import tree
from tree import BuildError, Entry

sys.path.append(str(Path(__file__).resolve().parents[1]))
import versions

from failstop.version import VERSION
from failstop_lab.pages import completion, man

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent.parent
SYSTEMD = CHECKOUT / "systemd"
SCRIPTS = ("preinst", "postinst", "prerm", "postrm", "triggers")
EXECUTABLE = (*SCRIPTS[:4], "unpack")
DEBIAN = re.sub(r"(a|b|rc)", r"~\1", VERSION)
"""The version as dpkg orders it: a trial of a version comes before it."""
EXTRAS = ("fleet", "web")
"""Those of failstop's whose needs the package brings along."""
ROBOT, LABORATORY = "failstop", "failstop-lab"
BILL = "usr/share/doc/failstop/failstop.cdx.json"
"""The packages of others that it holds, as CycloneDX."""
UNPACK = "unpack"
"""The script that unpacks the compiled modules."""
LAB = f"{tree.SITE}/failstop_lab/"
NOBODY = "failstop developers <root@localhost>"
UNITS = "usr/lib/systemd/system"
PLACES = {
    "failstop.catalog": "usr/lib/systemd/catalog/failstop.catalog",
    "failstop.sysusers": "usr/lib/sysusers.d/failstop.conf",
    # After the rules of ModemManager (77-80) and brltty (85).
    "failstop.udev": "usr/lib/udev/rules.d/90-failstop.rules",
}
"""Where the files of systemd/ go that are no units."""
COMPLETIONS = {
    "bash": "usr/share/bash-completion/completions/failstop",
    "zsh": "usr/share/zsh/vendor-completions/_failstop",
    "fish": "usr/share/fish/vendor_completions.d/failstop.fish",
}
"""Where each shell looks by itself."""


def main(words: Sequence[str] | None = None, interpreter: str = "/usr/bin/python3") -> int:
    """Build them, print their paths, and what to type next. `words`: others than the command line's; `interpreter`: the
    system's."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, default=CHECKOUT / "dist", help="the directory for it (default: dist)")
    add("--architecture", help="Debian's word, with --sites (default: this machine's)")
    add("--sites", type=Path, help="a folder for each Python (3.11, ...), with unpacked wheels for that architecture")
    arguments = parser.parse_args(words)
    out = arguments.out
    try:
        if not arguments.sites and (found := version_of(interpreter)) != tree.VERSION_HERE:
            advice = "use the system's Python: make deb PYTHON=/usr/bin/python3 VENV=.venv-deb"
            raise BuildError(
                f"the package would be for Python {tree.VERSION_HERE}, "
                f"and {interpreter} is {found or 'not here'}; {advice}"
            )
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="failstop-deb-") as directory:
            packages = build(Path(directory), out, arguments.architecture, arguments.sites)
            try:
                packages += library(Path(directory), out, arguments.architecture)
            except BuildError as error:
                if arguments.sites:  # a release has all its packages
                    raise
                print(f"failstop: {error}", file=sys.stderr)
    except BuildError as error:
        print(f"failstop: {error}", file=sys.stderr)
        return 1
    print(*packages, sep="\n")
    robots = os.path.relpath(packages[0])
    print(f"next: sudo apt install {robots if robots.startswith('..') else f'./{robots}'}")
    return 0


def version_of(interpreter: str) -> str:
    """The version of an interpreter, such as 3.11; empty where there is none."""
    words = (interpreter, "-I", "-S", "-c", "import sys; print('{}.{}'.format(*sys.version_info))")
    try:
        return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""


def build(directory: Path, out: Path, architecture: str | None = None, sites: Path | None = None) -> list[Path]:
    """Lay the packages out in a directory and pack them; returns their paths, the robot's first. `sites`: a folder for
    each Python, with the packages that failstop needs there; else they are the environment's. Raises BuildError."""
    architecture = architecture or _said("dpkg", "--print-architecture")
    folders = sorted(sites.iterdir(), key=lambda path: versions.numbers(path.name)) if sites else []
    finds = {path.name: tree.finder(path) for path in folders} or tree.here()
    interpreters = {python: interpreter(python) for python in finds}
    whole = tree.running(EXTRAS, finds)
    inside = [entry for entry in whole if entry.path.startswith(LAB)]
    robots = [entry for entry in whole if not entry.path.startswith(LAB)]
    held = [distribution for find in finds.values() for distribution in tree.needed(EXTRAS, find)]
    texts = files() | {BILL: sbom.text(sbom.packed(VERSION, held, architecture))}
    return [
        pack(ROBOT, robots, texts, directory, out, architecture, interpreters),
        pack(LABORATORY, inside, scripts(LABORATORY) | papers(LABORATORY), directory, out, architecture, interpreters),
    ]


def library(directory: Path, out: Path, architecture: str | None = None) -> list[Path]:
    """The packages of the C library. Raises BuildError."""
    ours = _said("dpkg", "--print-architecture")
    architecture = architecture or ours
    runtime, development = c_library.files(architecture, ours)
    runtime |= c_library.control(DEBIAN)
    return [
        _packed(directory / name, name, {**content, **papers(name)}, out, architecture)
        for name, content in ((c_library.RUNTIME, runtime), (c_library.DEVELOPMENT, development))
    ]


def interpreter(python: str) -> str:
    """An interpreter of this version, which compiles the modules for it. Raises BuildError."""
    found = sys.executable if python == tree.VERSION_HERE else versions.find(python, dict(os.environ))
    if not found:
        raise BuildError(
            f"no Python {python} was found to compile the modules for it: "
            f"make interpreter PYTHON_VERSION={python}, or pyenv or uv, which have those that no Debian has"
        )
    return found


def pack(
    name: str,
    entries: Collection[Entry],
    texts: Mapping[str, str],
    directory: Path,
    out: Path,
    architecture: str,
    interpreters: Mapping[str, str],
) -> Path:
    """One package of these files of the environment, for these Pythons, and of these texts."""
    root = directory / name
    environment = root / tree.PREFIX.lstrip("/")
    tree.write(entries, environment)
    (environment / tree.COMPILED).mkdir()
    if name == ROBOT:
        _write(environment / tree.COMPILED / UNPACK, (HERE / UNPACK).read_text())
    for python, found in interpreters.items():
        (environment / tree.COMPILED / f"{name}-{python}.tar.gz").write_bytes(tree.compiled(environment, found))
    for path, text in texts.items():
        _write(root / path, text)
    if name == ROBOT:
        (root / "usr/bin").mkdir(parents=True)
        (root / "usr/bin/failstop").symlink_to(f"{tree.PREFIX}/bin/failstop")
    return _closed(root, name, out, architecture, list(interpreters))


def _packed(root: Path, name: str, content: Mapping[str, bytes | str], out: Path, architecture: str) -> Path:
    """One package of these files; `-> target` is a link."""
    for path, data in content.items():
        if isinstance(data, str) and data.startswith("-> "):
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).symlink_to(data.removeprefix("-> "))
        else:
            _write(root / path, data)
    return _closed(root, name, out, architecture, ())


def _closed(root: Path, name: str, out: Path, architecture: str, pythons: Sequence[str]) -> Path:
    _control(root, name, architecture, pythons)
    for folder, _, _ in os.walk(root):
        os.chmod(folder, 0o755)
    # gzip: much faster than xz, and every dpkg reads it. The directory as target: dpkg-deb names the file.
    said = _said("dpkg-deb", "--root-owner-group", "-Zgzip", "-z4", "--build", str(root), str(out))
    return out / os.path.basename(said.split("'")[-2])


def files() -> dict[str, str]:
    """The texts of the robot's package but for the environment, by path; compressed where it ends in .gz."""
    units = {f"{UNITS}/{path.name}": path.read_text() for path in SYSTEMD.glob("*.service")}
    placed = {place: (SYSTEMD / name).read_text() for name, place in PLACES.items()}
    completions = {place: completion.script(shell) for shell, place in COMPLETIONS.items()}
    manual = {"usr/share/man/man1/failstop.1.gz": man.page()}
    return units | placed | completions | scripts(ROBOT) | manual | papers(ROBOT)


def scripts(package: str) -> dict[str, str]:
    """The maintainer scripts and triggers of a package, by path."""
    folder = HERE if package == ROBOT else HERE / "lab"
    return {f"DEBIAN/{name}": (folder / name).read_text() for name in SCRIPTS if (folder / name).exists()}


def papers(package: str) -> dict[str, str]:
    """Files that Debian wants to see in each package, by path."""
    licences = f"\nThe packages below {tree.PREFIX} have licences of their own, in their .dist-info directories.\n"
    overrides = HERE / f"{package}.lintian-overrides"
    told = {f"usr/share/lintian/overrides/{package}": overrides.read_text()} if overrides.exists() else {}
    return {
        **told,
        f"usr/share/doc/{package}/changelog.gz": changelog(package),
        f"usr/share/doc/{package}/copyright": (CHECKOUT / "LICENSE").read_text() + (licences if told else ""),
    }


def maintainer(environ: Mapping[str, str], folder: Path = CHECKOUT) -> str:
    """The maintainer of this package: DEBFULLNAME and DEBEMAIL, as Debian's tools have it, else git's user, or
    nobody."""
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
    """A version as Debian wants to see it."""
    who = maintainer(os.environ)
    date = email.utils.formatdate(int(os.environ.get("SOURCE_DATE_EPOCH", time.time())))
    return f"{package} ({DEBIAN}) unstable; urgency=medium\n\n  * Version {VERSION}.\n\n -- {who}  {date}\n"


def newest_libc(root: Path) -> str:
    """The newest version of glibc that a compiled module asks for."""
    found = {(2, 17)}
    for path in (path for path in root.rglob("*.so*") if path.is_file()):
        found |= {(2, int(minor)) for minor in re.findall(rb"GLIBC_2\.(\d+)", path.read_bytes())}
    return "{}.{}".format(*max(found))


def needs(pythons: Sequence[str]) -> str:
    """The dependency on a Python of one of these versions, which have no gap, as Debian writes it."""
    first, last = pythons[0], versions.numbers(pythons[-1])
    return f"python3 (>= {first}), python3 (<< {last[0]}.{last[1] + 1})"


def _control(root: Path, package: str, architecture: str, pythons: Sequence[str]) -> None:
    """DEBIAN/: the control file from its template, and the checksums."""
    regular = sorted(path for path in root.rglob("*") if path.is_file() and not path.is_symlink())
    regular = [path for path in regular if path.parent.name != "DEBIAN"]
    words = {
        "version": DEBIAN,
        "maintainer": maintainer(os.environ),
        "installed_kib": sum(path.stat().st_size for path in regular) // 1024 + 1,
        "architecture": architecture,
        "python": needs(pythons) if pythons else "",
        "libc": newest_libc(root),
    }
    _write(root / "DEBIAN/control", (HERE / f"{package}.control").read_text().format(**words))
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(root)}\n" for path in regular]
    _write(root / "DEBIAN/md5sums", "".join(sums))


def _write(path: Path, text: bytes | str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = text.encode() if isinstance(text, str) else text
    path.write_bytes(gzip.compress(data, 9, mtime=0) if path.suffix == ".gz" else data)
    os.chmod(path, 0o755 if path.name in EXECUTABLE else 0o644)


def _said(*words: str) -> str:
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
