"""`make release VERSION=x`: everything of a release, in dist/x: sdist, wheels, Debian packages and an image for two
architectures, what they hold of others (SBOM), notes, checksums.

What the last commit holds is released, as that version, whatever lies in the checkout beside it. Built twice from one
commit with the same wheels of others, all files are equal to the byte: their times are the commit's, and nothing of who
builds them, where, and in which language goes in. Raises no service and writes to no index.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import hashlib
import html
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "packaging" / part) for part in ("", "deb")]

import image  # noqa: E402
import interpreter  # noqa: E402
import lock  # noqa: E402
import sbom  # noqa: E402
import tree  # noqa: E402
import versions  # noqa: E402

from failstop_lab.pages import public, ros_changes  # noqa: E402

MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
"""Architectures by Debian's word, with Python's."""
GLIBC = ("manylinux2014", "manylinux_2_17", "manylinux_2_27", "manylinux_2_28")
"""Tags of the wheels that run on what the packages are for: Ubuntu 22.04 and Debian 12 have newer ones."""
EXTRAS = lock.EXTRAS
LAB = "failstop-lab"
MAINTAINER = {"DEBFULLNAME": "failstop developers", "DEBEMAIL": "failstop@example.org"}
VERSION = re.compile(r"\d+\.\d+\.\d+((a|b|rc)\d+)?")
AT_ONCE = "**Removed at once**"
"""In the changelog: before public names that a release takes away because they let wheels turn that should not."""
EXECUTABLE, PLAIN = 0o755, 0o644
WORLDS: tuple[tuple[int, dict[str, str]], ...] = (
    (0o022, {"LC_ALL": "C", "TZ": "UTC", "PYTHONHASHSEED": "1"}),
    (0o077, {"LC_ALL": "C.UTF-8", "TZ": "Asia/Kathmandu", "PYTHONHASHSEED": "2"}),
)
"""Umask and environment of two builders."""


class ReleaseError(Exception):
    """Nothing is released; the message is one line with the remedy."""


def main(words: Sequence[str] | None = None) -> int:
    """Build it, and print what there is."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0] if __doc__ else None)
    parser.add_argument("version")
    parser.add_argument("--out", type=Path, help="the directory for it (default: dist/VERSION)")
    parser.add_argument("--wheels", type=Path, help="keep the wheels of others here, and take those that are there")
    parser.add_argument("--homepage", default="", help="the address of the repository, for links that work on an index")
    parser.add_argument("--keep", action="store_true", help="keep what is there, if it is of this commit and unchanged")
    parser.add_argument("--twice", action="store_true", help="build it in two places, as two builders, and compare")
    arguments = parser.parse_args(words)
    # Whole paths, since each step runs in a folder of its own.
    out = (arguments.out or ROOT / "dist" / arguments.version).resolve()
    wheels = arguments.wheels.resolve() if arguments.wheels else None
    stamp, key = out.with_name(f".{out.name}.built"), made_of(arguments.version, arguments.homepage)
    if arguments.keep and not arguments.twice and whole(out, stamp, key):
        print(*sorted(out.iterdir()), sep="\n")
        return 0
    try:
        with tempfile.TemporaryDirectory(prefix="failstop-release-") as folder:
            if arguments.twice:
                made = twice(arguments.version, Path(folder), wheels or Path(folder, "wheels"))
                print(f"built twice, equal to the byte: {len(made)} files")
                return 0
            stamp.unlink(missing_ok=True)
            made = release(arguments.version, out, Path(folder), wheels, arguments.homepage)
            stamp.write_text(key)
    except (ReleaseError, subprocess.CalledProcessError) as error:
        print(f"failstop: {error}", file=sys.stderr)
        return 1
    print(*made, sep="\n")
    return 0


def release(version: str, out: Path, folder: Path, wheels: Path | None = None, homepage: str = "") -> list[Path]:
    """Every file of the release, in `out`, which is emptied first; `folder` is to work in. `homepage`: the address of
    the repository; without one the packages name none, and their long description has the README's own links. Raises
    ReleaseError."""
    if not VERSION.fullmatch(version):
        raise ReleaseError(f"{version} is no version: it has three numbers, as 0.2.0, and rc1 behind them for a trial")
    os.umask(0o022)
    environ = surroundings()
    os.environ["SOURCE_DATE_EPOCH"] = environ["SOURCE_DATE_EPOCH"]
    source = folder / "source"
    stage(version, source)
    maintained(source, environ["DEBFULLNAME"], environ["DEBEMAIL"])
    if homepage:
        addressed(source, homepage.rstrip("/"), version)
    told = notes((source / "CHANGELOG.md").read_text(), version)
    lasting(version, (source / public.PLACE).read_text(), told)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    wheels = wheels or folder / "wheels"
    locked = lock.read((source / "packaging/lock.txt").read_text())
    for architecture, machine in MACHINES.items():
        for python3 in versions.VERSIONS:
            kept = wheels / architecture / python3
            unpack(fetched(locked, kept, machine, python3, tree.NOT_PACKED), folder / architecture / python3)
    unpack(fetched(locked, wheels / "needed", MACHINES["amd64"], versions.VERSIONS[0]), folder / "needed")
    bill = sbom.text(sbom.needing(version, tree.needed(EXTRAS, tree.finder(folder / "needed"), ())))
    laboratory = sbom.text(sbom.needing(version, (), LAB))
    python(source, folder / "built", environ, {"failstop": bill, LAB.replace("-", "_"): laboratory}, out)
    for architecture in MACHINES:
        sites = folder / architecture
        run(
            *(sys.executable, "packaging/deb/build.py", "--out", out, "--architecture", architecture, "--sites", sites),
            cwd=source,
            environ=environ | {"PYTHONPATH": f"{source}:{source}/lab"},
        )
    if why := image.missing():
        print(f"failstop: no image for containers: {why}", file=sys.stderr)
    else:
        debs = {
            one: [path for part in (one, "all") for path in sorted(out.glob(f"failstop*_{part}.deb"))]
            for one in MACHINES
        }
        if not all(debs.values()):
            raise ReleaseError(f"there are no Debian packages in {out}, of which the image would be made")
        image.make(version, debs, wheels, out, homepage)
    (out / f"failstop-{version}.cdx.json").write_text(bill)
    (out / "NOTES.md").write_text(told)
    made = sorted(out.iterdir())
    sums = "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in made)
    (out / "SHA256SUMS").write_text(sums)
    return [*made, out / "SHA256SUMS"]


def made_of(version: str, homepage: str) -> str:
    """What the files of a release depend on, besides what an index and the compilers give."""
    maker = [surroundings()[name] for name in ("SOURCE_DATE_EPOCH", *MAINTAINER)]
    return json.dumps([said("git", "rev-parse", "HEAD"), version, homepage, *maker])


def whole(out: Path, stamp: Path, key: str) -> bool:
    """Whether a release that was made of `key` lies there with every file unchanged."""
    sums = out / "SHA256SUMS"
    if not sums.exists() or not stamp.exists() or stamp.read_text() != key:
        return False
    rows = [line.split("  ") for line in sums.read_text().splitlines()]
    return all(
        (out / name).exists() and hashlib.sha256((out / name).read_bytes()).hexdigest() == digest
        for digest, name in rows
    )


def twice(version: str, folder: Path, wheels: Path) -> list[Path]:
    """The files of two builds from clones of this checkout. Raises ReleaseError with the first that is not equal."""
    outs = []
    for number, (umask, world) in enumerate(WORLDS):
        place = folder / f"builder-{number}" / ("x" * number)
        outs.append(folder / f"out-{number}")
        subprocess.run(["git", "clone", "--quiet", "--local", ROOT, place], check=True)
        words = (sys.executable, place / "packaging/release.py", version, "--out", outs[-1], "--wheels", wheels)
        os.umask(umask)
        run(*words, cwd=place, environ=os.environ | surroundings() | world | {"HOME": str(place)})
    if differs := first_difference(*outs):
        raise ReleaseError(f"two builds of {version} are not equal: {differs}{explained(outs[0], outs[1], differs)}")
    return sorted(outs[0].iterdir())


def surroundings() -> dict[str, str]:
    """The environment of every step: the commit's time, and nothing of the machine's but where its programs are."""
    moment = os.environ.get("SOURCE_DATE_EPOCH") or said("git", "log", "-1", "--format=%ct")
    # A workflow sets a variable that its repository lacks to nothing.
    kept = {name: os.environ[name] for name in ("PATH", "HOME", *MAINTAINER) if os.environ.get(name)}
    kept |= {interpreter.FOLDER: str(interpreter.folder())}
    kept |= {"PYENV_ROOT": os.environ.get("PYENV_ROOT", os.path.expanduser("~/.pyenv"))}
    fixed = {"SOURCE_DATE_EPOCH": moment, "PYTHONHASHSEED": "0", "LC_ALL": "C.UTF-8", "TZ": "UTC"}
    return MAINTAINER | kept | fixed


def stage(version: str, source: Path) -> None:
    """The last commit's files, with this version."""
    archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        files.extractall(source)
    change(source / "failstop/version.py", r'VERSION = ".*"', f'VERSION = "{version}"')
    moment = int(os.environ["SOURCE_DATE_EPOCH"])
    day = time.strftime("%Y-%m-%d", time.gmtime(moment))
    changes = source / "CHANGELOG.md"
    change(changes, r"## Unreleased", f"## {version} ({day})", needed=False)
    for name, folder in ros_changes.FOLDERS.items():
        package = source / folder
        change(package / "package.xml", r"<version>.*</version>", f"<version>{version}</version>")
        (package / "CHANGELOG.rst").write_text(ros_changes.text(name, changes.read_text()))
    change(source / "failstop/ros2/packages/failstop_ros2/setup.py", r'version=".*"', f'version="{version}"')
    for path in [source, *source.rglob("*")]:
        if not path.is_symlink():
            path.chmod(EXECUTABLE if path.is_dir() or path.stat().st_mode & 0o100 else PLAIN)
            os.utime(path, (moment, moment))


def maintained(source: Path, name: str, address: str) -> None:
    """Name the maintainer in the manifests of the ROS packages, as the Debian packages do."""
    name, address = html.escape(name), html.escape(address)
    for folder in ros_changes.FOLDERS.values():
        for tag in ("maintainer", "author"):
            tagged = f'<{tag} email="{address}">{name}</{tag}>'
            change(source / folder / "package.xml", f"<{tag} .*</{tag}>", tagged.replace("\\", r"\\"))


def addressed(source: Path, homepage: str, version: str) -> None:
    """Name the repository in the metadata of every package, and lead the links of the long description there: an index
    shows it without the files around it. Raises ReleaseError for an address that is none."""
    if not re.fullmatch(r"https://[^\s/]+/\S+", homepage):
        raise ReleaseError(
            f"--homepage {homepage} is no address of a repository, such as https://example.org/me/failstop"
        )
    tree_at, raw_at = f"{homepage}/blob/v{version}", f"{homepage}/raw/v{version}"
    pages = {"Homepage": homepage, "Documentation": f"{tree_at}/docs/README.md", "Changelog": f"{tree_at}/CHANGELOG.md"}
    urls = {**pages, "Issues": f"{homepage}/issues"}
    table = "".join(f'{name} = "{url}"\n' for name, url in urls.items())
    for project in ("pyproject.toml", "integrations/lerobot/pyproject.toml"):
        change(source / project, r"(?m)^\[tool\.setuptools\]", f"[project.urls]\n{table}\n[tool.setuptools]")
    change(source / "lab/setup.py", r'(?m)^    license="MIT",', f'    license="MIT",\n    project_urls={urls!r},')
    for control in ("failstop", "failstop-lab", "libfailstop0", "libfailstop-dev"):
        change(source / f"packaging/deb/{control}.control", "(?m)^Description:", f"Homepage: {homepage}\nDescription:")
    kinds = {"website": homepage, "repository": homepage, "bugtracker": urls["Issues"]}
    linked = "".join(f'  <url type="{kind}">{html.escape(url)}</url>\n' for kind, url in kinds.items())
    for folder in ros_changes.FOLDERS.values():
        change(source / folder / "package.xml", r"(?m)(^  <license>.*\n)", rf"\1{linked}")
    for readme in ("README.md", "integrations/lerobot/README.md"):
        path = source / readme
        path.write_text(absolute(path.read_text(), os.path.dirname(readme), tree_at, raw_at))


def absolute(text: str, folder: str, tree_at: str, raw_at: str) -> str:
    """A page of this folder with its relative links below these addresses, those of pictures below `raw_at`."""

    def led(found: re.Match[str]) -> str:
        path, mark, part = found["path"].partition("#")
        if not path or "://" in path or path.startswith("mailto:"):
            return found[0]
        inside = os.path.normpath(os.path.join(folder, path))
        return f"{found['before']}{raw_at if found['picture'] else tree_at}/{inside}{mark}{part})"

    return re.sub(r"(?P<before>(?P<picture>!?)\[[^\]]*\]\()(?P<path>[^)\s]+)\)", led, text)


def change(path: Path, pattern: str, new: str, *, needed: bool = True) -> None:
    """Put `new` for the one place that the pattern finds."""
    text, count = re.subn(pattern, new, path.read_text(), count=1)
    if needed and not count:
        raise ReleaseError(f"{path.name} has no {pattern}, which is to become {new}")
    path.write_text(text)


def lasting(version: str, names: str, told: str, root: Path = ROOT) -> None:
    """Check the public names against those of the last release, a tag `v*` before this commit. Raises ReleaseError for
    those that are gone and may not be (SECURITY.md), unless the notes have them below AT_ONCE."""
    tag = ("git", "describe", "--tags", "--match", "v*", "--abbrev=0", "HEAD")
    last = subprocess.run(tag, cwd=root, capture_output=True, text=True, check=False).stdout.strip()
    if last == f"v{version}":
        last = subprocess.run(
            (*tag[:-1], "HEAD^"), cwd=root, capture_output=True, text=True, check=False
        ).stdout.strip()
    show = ("git", "show", f"{last}:{public.PLACE}")
    before = subprocess.run(show, cwd=root, capture_output=True, text=True, check=False).stdout if last else ""
    minor = series(version) != series(last.removeprefix("v"))
    gone = [name for name in public.lost(before, names, minor=minor) if name not in told.partition(AT_ONCE)[2]]
    if gone:
        advice = f"bring them back and deprecate them first, or name them in CHANGELOG.md below {AT_ONCE}"
        raise ReleaseError(
            f"public names of {last} are gone that it did not call deprecated: {', '.join(gone)}; {advice}"
        )


def series(version: str) -> list[str]:
    """The numbers of a version that count its breaks: the first, and before 1.0 the second."""
    numbers = version.split(".")
    return numbers[: 2 if numbers[0] == "0" else 1]


def fetched(
    locked: Sequence[lock.Locked], folder: Path, machine: str, python3: str, without: Collection[str] = ()
) -> list[Path]:
    """The wheels of what failstop needs with its extras, for a machine and a Python, without some; fetched unless those
    of this lock are there. pip refuses a file whose hash is not in the lock."""
    wanted = lock.needed(locked, python3, without)
    if not kept(folder, wanted):
        shutil.rmtree(folder, ignore_errors=True)
        platforms = [word for glibc in GLIBC for word in ("--platform", f"{glibc}_{machine}")]
        pip = (sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps")
        only = ("--only-binary=:all:", "--implementation", "cp", "--python-version", python3)
        part = folder.with_name(f"{folder.name}.part")
        part.mkdir(parents=True, exist_ok=True)
        (part / "locked.txt").write_text(wanted)
        run(*pip, *only, *platforms, "--require-hashes", "--dest", part, "-r", part / "locked.txt", cwd=ROOT)
        part.rename(folder)
    return sorted(folder.glob("*.whl"))


def kept(folder: Path, wanted: str) -> bool:
    """Whether the wheels in a folder are those of these lines of a lock, by their hashes."""
    found = [hashlib.sha256(wheel.read_bytes()).hexdigest() for wheel in folder.glob("*.whl")]
    return len(found) == len(wanted.splitlines()) and all(f"sha256:{digest}" in wanted for digest in found)


def unpack(wheels: Sequence[Path], site: Path) -> None:
    """Lay wheels out as an installer does, without their scripts, which name an interpreter; each with its hash."""
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as packed:
            names = [name for name in packed.namelist() if ".data/" not in name]
            packed.extractall(site, names)
        (about,) = {name.partition("/")[0] for name in names if ".dist-info/" in name}
        digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
        origin = {"url": wheel.name, "archive_info": {"hashes": {"sha256": digest}}}
        (site / about / "direct_url.json").write_text(json.dumps(origin))


def python(source: Path, built: Path, environ: Mapping[str, str], bills: Mapping[str, str], out: Path) -> None:
    """The sdist, the wheel that is built from it, and the laboratory's; `bills` by what a wheel's name begins with."""
    build = (sys.executable, "-m", "build", "--no-isolation")
    run(*build, "--outdir", built, ".", cwd=source, environ=environ)
    run(*build, "--wheel", "--outdir", built, "lab", cwd=source, environ=environ)
    for path in sorted(built.iterdir()):
        if path.suffix == ".whl":
            with_bill(path, out / path.name, bills[path.name.partition("-")[0]])
        else:
            steady(path, out / path.name)


def with_bill(wheel: Path, new: Path, bill: str) -> None:
    """A wheel with its SBOM where PEP 770 wants it, and with fixed order, times and modes."""
    with zipfile.ZipFile(wheel) as old:
        files = {name: old.read(name) for name in old.namelist()}
    (record,) = (name for name in files if name.endswith(".dist-info/RECORD"))
    del files[record]
    files[f"{os.path.dirname(record)}/sboms/failstop.cdx.json"] = bill.encode()
    lines = [f"{name},sha256={_hash(data)},{len(data)}\n" for name, data in sorted(files.items())]
    rows = [*sorted(files.items()), (record, "".join([*lines, f"{record},,\n"]).encode())]
    with zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in rows:
            # The oldest time that a zip has: it knows no zone, and the commit's stands in the sdist.
            row = zipfile.ZipInfo(name)
            row.external_attr = (0o100000 | PLAIN) << 16
            row.compress_type = zipfile.ZIP_DEFLATED
            packed.writestr(row, data)


def _hash(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def steady(sdist: Path, new: Path) -> None:
    """An sdist with fixed order, owner, times and modes."""
    inside = io.BytesIO()
    with tarfile.open(sdist) as old, tarfile.open(fileobj=inside, mode="w", format=tarfile.PAX_FORMAT) as packed:
        for row in sorted(old, key=lambda row: row.name):
            row.uid = row.gid = 0
            row.uname = row.gname = ""
            row.mtime = int(os.environ["SOURCE_DATE_EPOCH"])
            row.mode = EXECUTABLE if row.isdir() or row.mode & 0o100 else PLAIN
            row.pax_headers = {}
            packed.addfile(row, old.extractfile(row) if row.isfile() else None)
    new.write_bytes(gzip.compress(inside.getvalue(), 9, mtime=0))


def notes(changes: str, version: str) -> str:
    """The changelog's part on this version."""
    parts = re.split(r"^## (.+)$", changes, flags=re.MULTILINE)
    for title, text in zip(parts[1::2], parts[2::2], strict=True):
        if title.split()[0] == version:
            return f"# failstop {version}\n\n{text.strip()}\n"
    raise ReleaseError(f"CHANGELOG.md has neither a part `## {version}` nor `## Unreleased`: write what is new")


def first_difference(one: Path, other: Path) -> str:
    """The first file of two releases that is not equal, with the first of its members that is not; empty: none."""
    for name in sorted({path.name for folder in (one, other) for path in folder.iterdir()} - {"SHA256SUMS"}):
        left, right = (folder / name for folder in (one, other))
        if not left.exists() or not right.exists():
            return f"{name} is in one of them alone"
        if left.read_bytes() != right.read_bytes():
            there, here = members(left), members(right)
            names = [member for member in sorted({*there, *here}) if there.get(member) != here.get(member)]
            return f"{name}: {names[0] if names else 'order, times, modes or compression'}"
    return ""


def explained(one: Path, other: Path, differs: str) -> str:
    """The difference of a file in the words of diffoscope, where it is installed and the file is in both."""
    name = differs.partition(": ")[0]
    if not shutil.which("diffoscope") or not (one / name).exists() or not (other / name).exists():
        return ""
    words = ("diffoscope", "--text", "-", "--max-text-report-size", "4000", one / name, other / name)
    return "\n" + subprocess.run(words, capture_output=True, text=True, check=False).stdout


def members(path: Path) -> dict[str, bytes]:
    """The files in an archive, by name."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as packed:
            return {name: packed.read(name) for name in packed.namelist()}
    data = path.read_bytes()
    if path.suffix == ".deb":
        data = subprocess.run(["dpkg-deb", "--fsys-tarfile", path], check=True, capture_output=True).stdout
    elif path.suffix != ".gz":
        return {path.name: data}
    with tarfile.open(fileobj=io.BytesIO(data)) as packed:
        return {row.name: f"{row.mtime} {row.mode} ".encode() + _content(packed, row) for row in packed}


def _content(packed: tarfile.TarFile, row: tarfile.TarInfo) -> bytes:
    found = packed.extractfile(row) if row.isfile() else None
    return found.read() if found else row.linkname.encode()


def said(*words: str) -> str:
    """The words that a command prints, in the checkout."""
    return subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def run(*words: str | Path, cwd: Path, environ: Mapping[str, str] | None = None) -> None:
    """Run a step; what it says is shown where it fails."""
    done = subprocess.run(words, cwd=cwd, env=environ, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ReleaseError(f"{' '.join(map(str, words[:4]))} failed:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    sys.exit(main())
