"""Debian's own judges of the packages, for `make package-test`.

autopkgtest runs packaging/deb/tests against what is installed, in a container with a systemd (testbed.py). piuparts
installs, removes and purges in a fresh Debian, and looks at what is left.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench import BenchError, stats
from bench.container import Container
from bench.report import progress
from tests.packaging import debian

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "packaging/deb/tests"
TESTED_S = 600.0
USER = "tester"
"""The user in the container for the tests that do not ask for root."""
SETUP = f"""
rm -f /usr/sbin/policy-rc.d
useradd --create-home {USER}
# No network in there, and all that the packages need is installed: apt would ask for its lists for minutes.
rm -f /etc/apt/sources.list /etc/apt/sources.list.d/*
"""
INSIDE = (
    *("systemd", "systemd-sysv", "init-system-helpers", "udev", "procps", "python3", "openssl"),
    *("apt-utils", "dpkg-dev", "gcc", "libc6-dev", "libstdc++6"),
)
"""Packages of a system that boots in a container: what a machine has, what autopkgtest installs packages with, what the
tests need, and libstdc++6 for packages of before 0.2, which depend on it."""
TESTBED = Path(__file__).with_name("testbed.py")
LEFT = ("--ignore=/var/cache/debconf/tmp.ci/",)
"""debconf of Debian 13 leaves its folder for any package that it has unpacked; piuparts names folders with a / at the
end."""
BOOTS = ("systemd", "systemd-sysv", "init-system-helpers")
"""Packages of every Debian that boots. As dependencies that piuparts installs and purges, they would leave folders of
systemd's own (/root/.ssh, /var/lib/private and others), which count as failstop's then."""


def source(packages: Sequence[Path], folder: Path) -> Path:
    """A folder with the tests as autopkgtest looks for them: those of a source package with these binary packages."""
    debian = folder / "debian"
    shutil.copytree(TESTS, debian / "tests")
    fields = [{name: field(path, name) for name in ("Package", "Version", "Maintainer")} for path in packages]
    first = fields[0]
    binaries = "".join(f"\nPackage: {one['Package']}\nArchitecture: any\nDescription: tested\n" for one in fields)
    (debian / "control").write_text(f"Source: {first['Package']}\nMaintainer: {first['Maintainer']}\n{binaries}")
    entry = f"{first['Package']} ({first['Version']}) unstable; urgency=medium\n\n  * Tested.\n\n"
    (debian / "changelog").write_text(f"{entry} -- {first['Maintainer']}  Thu, 01 Jan 1970 00:00:00 +0000\n")
    return folder


def field(package: Path, name: str) -> str:
    """A field of a package's control file."""
    words = ("dpkg-deb", "--field", str(package), name)
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


def booted(suite: str) -> Path:
    """A fresh system of a suite with a systemd and all that the packages and these tests need, since a container has no
    network. Raises BenchError."""
    return debian.unpacked(suite, INSIDE)


def autopkgtest(packages: Sequence[Path], suite: str) -> stats.Row:
    """Its verdict on each test, on a Debian. Raises BenchError, ContainerMissing."""
    measure = f"{title(suite)}: autopkgtest of the installed packages"
    if not (program := shutil.which("autopkgtest")):
        return skipped(measure, "autopkgtest")
    progress(f"autopkgtest, {suite}")
    with tempfile.TemporaryDirectory(prefix="failstop-autopkgtest-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        source(packages, folder / "source")
        with Container({}, (), SETUP, booted(suite)) as box:
            testbed = (sys.executable, str(TESTBED), str(box.path("/")), *box.entering())
            words = (program, "--no-built-binaries", "--user", USER, *map(str, packages), str(folder / "source"))
            done = _run_for(TESTED_S, *words, "--", *testbed)
    told = dict(re.findall(r"^(\S+)\s+(PASS|FAIL|SKIP|FLAKY)", done.stdout, re.MULTILINE))
    wanted = re.findall(r"^Tests: (\S+)$", (TESTS / "control").read_text(), re.MULTILINE)
    passed = [test for test in wanted if told.get(test) == "PASS"]
    if len(passed) < len(wanted):
        print(done.stdout[-6000:], done.stderr[-4000:], sep="\n", file=sys.stderr)
    found = f"{len(passed)} of {len(wanted)} passed"
    return stats.Row(measure, found, f"{len(wanted)} passed", len(passed) == len(wanted), {"told": told})


def _run_for(timeout_s: float, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a judge. Raises BenchError when it takes too long."""
    try:
        return subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout_s, check=False
        )
    except subprocess.TimeoutExpired:
        raise BenchError(f"{words[0]} took more than {timeout_s:g} s") from None


def title(suite: str) -> str:
    """A suite as people name it."""
    return f"Debian {debian.SUITES[suite].number}"


def piuparts(packages: Sequence[Path], suite: str) -> stats.Row:
    """Its verdict on installation, removal and purge in a fresh Debian, made from the package index. Raises
    BenchError."""
    measure = f"{title(suite)}: a purge leaves it as it was (piuparts)"
    for program in ("piuparts", "mmdebstrap"):
        if not shutil.which(program):
            return skipped(measure, program)
    progress(f"piuparts, {suite}")
    with tempfile.TemporaryDirectory(prefix="failstop-piuparts-") as name:
        base = Path(name, "debian.tar.gz")
        make = ("mmdebstrap", "--quiet", "--variant=minbase", f"--include={','.join(BOOTS)}", suite, str(base))
        made = subprocess.run(make, capture_output=True, text=True, check=False)
        if made.returncode:
            raise BenchError(f"no fresh Debian can be made: {made.stdout[-2000:]}{made.stderr[-2000:]}")
        words = (
            "piuparts",
            "--distribution",
            suite,
            "--basetgz",
            str(base),
            "--no-eatmydata",
            *LEFT,
            *map(str, packages),
        )
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    wrong = complaints(done.stdout + done.stderr)
    if done.returncode:
        print(done.stdout[-6000:], done.stderr[-4000:], sep="\n", file=sys.stderr)
    found = "; ".join(wrong[:3]) if wrong else "yes" if not done.returncode else f"exit code {done.returncode}"
    return stats.Row(measure, found, "yes", not done.returncode, {"wrong": wrong})


def complaints(text: str) -> list[str]:
    """What piuparts says is wrong. It calls its warnings errors too, and passes with them."""
    return re.findall(r"ERROR: (?!WARN:)(.*)", text)


def skipped(measure: str, program: str) -> stats.Row:
    """A row of what was not tried."""
    return stats.Row(measure, f"skipped: not installed (apt install {program})", "-", None, {})
