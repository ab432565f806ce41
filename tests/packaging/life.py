"""The life of a release's Debian packages: `python -m tests.packaging.life dist/VERSION` (`make package-test`).

lintian, piuparts and autopkgtest judge them. In a container with a systemd the last release is installed, upgraded as a
program drives, removed, purged. Then the system's Python becomes the next Debian's under the installed package, as a
program drives.

The simulated board judges the wheels, and systemd's own clock how long the service was away.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from bench import BenchError, report, stats
from bench.container import ContainerMissing
from bench.report import progress
from bench.service_scene import READY
from failstop_lab.sim.client import Event
from tests.packaging import debian, debian_tests
from tests.support.package_scene import BOARD, OLDER, SETTINGS, UNIT, Place, machine

ROOT = Path(__file__).resolve().parents[2]
ROUNDS = 3
SUITES = ("bookworm", "trixie")
"""The Debian releases that it is tried on; the first can install the last release."""
WITHOUT_A_TAG = "42a3b47e202b"
"""The commit whose package stands for the last release, as long as no release has a tag."""
AWAY_S = 5.0
NOBODY = 65534
KEPT = (SETTINGS, "/var/lib/failstop", "/etc/failstop")
"""Paths that a removal leaves: settings, logs and incidents."""
DRIVER = "/run/driver.py"
FOLLOWING = {"bookworm": "trixie", "trixie": "forky"}
"""The Debian whose Python becomes the system's, as in an upgrade of Debian."""
FETCH = """
set -eu
sed -nE 's/^deb (\\[[^]]*\\] )?(\\S+) {suite} .*/deb \\2 {following} main/p' /etc/apt/sources.list |
  head -n 1 >/etc/apt/sources.list.d/next.list
mkdir -p /packages/partial
apt-get -qq -o Acquire::Check-Valid-Until=false update
apt-get install --download-only --yes -qq -o Dir::Cache::Archives=/packages -t {following} python3
"""
FETCHED_S, CHANGED_S = 300.0, 600.0


class Away(NamedTuple):
    """One upgrade while a program drives."""

    frames: int
    """For the motors, from the first stop on."""
    moved: int
    """Of these: that would turn a wheel. 0 is right."""
    stopped: bool
    """There was a stop, and the wheels stood at the end."""
    away_s: float
    """From when the old service has ended to when the new one is ready."""


def main() -> int:
    """Judge them, and print a table; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description="The life of the Debian packages.")
    add = parser.add_argument
    add("release", type=Path, help="the folder of a release (make release)")
    add("--last", default="", help="the last release: a .deb, or a commit to build it from (default: the newest tag)")
    add("--suites", default=",".join(SUITES), help=f"Debian releases (default: {','.join(SUITES)})")
    add("--rounds", type=int, default=ROUNDS, help=f"upgrades, each from the last release (default: {ROUNDS})")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="failstop-packages-") as folder:
        try:
            new = newest(arguments.release)
            old = last(arguments.last, Path(folder))
            ours = fitting(new, architecture())
            rows = lintian(new)
            for suite in arguments.suites.split(","):
                rows += [debian_tests.autopkgtest(ours, suite), debian_tests.piuparts(ours, suite)]
                # The last release may be for one Debian alone; elsewhere it is this one, as an older version.
                before = old if suite == SUITES[0] else older(ours[0], Path(folder))
                rows += lived(before, ours[0], arguments.rounds, suite)
                rows += another_python(ours[0], suite)
        except (BenchError, ContainerMissing) as error:
            print(f"failstop: {error}", file=sys.stderr)
            return 1
    return report.end(rows, last_release=old.name, packages=[path.name for path in new])


def newest(debs: Path) -> list[Path]:
    """The packages to judge, the robot's first. Raises BenchError."""
    found, ours = sorted(debs.glob("*.deb")), architecture()
    robots = [path for path in fitting(found, ours) if path.name.startswith("failstop_")]
    if not robots:
        raise BenchError(f"no package for {ours} in {debs}: make release VERSION=x builds them")
    return [*robots, *(path for path in found if path not in robots)]


def architecture() -> str:
    """This machine's, by Debian's word."""
    words = ("dpkg", "--print-architecture")
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


def fitting(packages: Sequence[Path], ours: str) -> list[Path]:
    """Those that a machine of this architecture can install: a release has packages for others too."""
    return [path for path in packages if path.stem.rpartition("_")[2] in (ours, "all")]


def build(source: Path, out: Path) -> list[Path]:
    """The packages of a checkout, with what this environment has of others. Raises BenchError."""
    progress(f"building the packages of {source}")
    words = (sys.executable, source / "packaging/deb/build.py", "--out", out)
    done = subprocess.run(
        words,
        env=os.environ | {"PYTHONPATH": f"{source}:{source}/lab"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise BenchError(f"the packages of {source} can't be built: {done.stdout}{done.stderr}")
    return [source / line for line in done.stdout.splitlines() if not line.startswith("next: ")]


def last(wanted: str, folder: Path) -> Path:
    """The robot's package of the last release. Raises BenchError."""
    if wanted.endswith(".deb"):
        return Path(wanted)
    tag = ("git", "describe", "--tags", "--match", "v*", "--abbrev=0")
    told = subprocess.run(tag, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    commit = wanted or told or WITHOUT_A_TAG
    done = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=False)
    if done.returncode:
        advice = "a clone with its whole history has it, or give --last FILE.deb"
        raise BenchError(f"the last release can't be built, since commit {commit} is not in this clone: {advice}")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as files:
        files.extractall(folder / "source")
    return build(folder / "source", folder / "old")[0]


def lintian(packages: list[Path]) -> list[stats.Row]:
    """Its errors and warnings, overrides that say of nothing, and those without a reason above them."""
    if not (program := shutil.which("lintian")):
        return [debian_tests.skipped("lintian", "lintian")]
    progress("lintian")
    done = subprocess.run(
        [program, "--allow-root", "--display-info", "--tag-display-limit", "0", *packages],
        capture_output=True,
        text=True,
        check=False,
    )
    told = re.findall(r"^([EWI]): (\S+?): (.*)$", done.stdout, re.MULTILINE)
    if done.returncode not in (0, 2):
        raise BenchError(f"lintian failed: {done.stdout}{done.stderr}")
    wrong = [f"{package}: {text}" for letter, package, text in told if letter in "EW" or "unused-override" in text]
    bare, overrides = [], 0
    for path in sorted((ROOT / "packaging/deb").glob("*.lintian-overrides")):
        above = ""
        for line in path.read_text().splitlines():
            if not line.startswith("#"):
                overrides += 1
                bare += [line] * (not above)
            above = line
    said = f"; the first: {wrong[0]}" if wrong else ""
    found = f"{len(wrong)} in {len(packages)} packages{said}"
    return [
        stats.Row("lintian: errors, warnings, overrides of nothing", found, "0", not wrong, {"found": wrong}),
        stats.count("lintian: overrides without a reason", len(bare), overrides),
    ]


def older(package: Path, folder: Path) -> Path:
    """The same package with a lower version. Raises BenchError."""
    root, out = folder / "older", folder / "older.deb"
    shutil.rmtree(root, ignore_errors=True)
    subprocess.run(["dpkg-deb", "--raw-extract", package, root], check=True)
    control = root / "DEBIAN/control"
    control.write_text(re.sub("^Version: .*", f"Version: {OLDER}", control.read_text(), flags=re.MULTILINE))
    done = subprocess.run(["dpkg-deb", "--root-owner-group", "-Znone", "--build", root, out], capture_output=True)
    if done.returncode:
        raise BenchError(f"no older package can be made: {done.stderr.decode()}")
    return out


def lived(old: Path, new: Path, rounds: int, suite: str) -> list[stats.Row]:
    """An installation, upgrades from the last release, a removal, a purge, on a Debian. Raises BenchError,
    ContainerMissing."""
    rows = _lived(old, new, rounds, debian_tests.booted(suite))
    return [dataclasses.replace(row, measure=f"{debian_tests.title(suite)}: {row.measure}") for row in rows]


def _lived(old: Path, new: Path, rounds: int, system: Path) -> list[stats.Row]:
    with machine(system) as place:
        for name, path in (("old", old), ("new", new)):
            shutil.copy(path, place.packages / f"{name}.deb")
        before = place.files()
        progress("installing the last release")
        settings = f'# mine\n[device]\npath = "{BOARD}"\n'
        place.box.write(SETTINGS, settings)
        place.dpkg("-i", "/packages/old.deb")
        place.box.wait(UNIT, 60.0, **READY)
        upgrades = []
        for turn in range(rounds):
            progress(f"upgrade {turn + 1} of {rounds}")
            # Nobody upgrades so often that systemd refuses to start it (StartLimitBurst).
            place.box.ctl("reset-failed", UNIT)
            upgrades.append(upgraded(place))
            if turn + 1 < rounds:
                place.dpkg("--force-confold", "--force-downgrade", "-i", "/packages/old.deb")
                place.box.wait(UNIT, 60.0, **READY)
        rows = upgrade_rows(upgrades)
        rows.append(verdict("an upgrade keeps the settings", [] if place.settings() == settings else ["not kept"]))
        unverified = place.box.run("dpkg", "--verify", "failstop", check=False).stdout.splitlines()
        rows.append(verdict("every file of the package is as packed", unverified))
        rows += gone(place, before)
    return rows


def upgraded(place: Place) -> Away:
    """Upgrade while a program drives; it goes on commanding through it."""
    with driving(place):
        place.board.events()
        place.dpkg("--force-confold", "-i", "/packages/new.deb")
        place.box.wait(UNIT, 60.0, **READY)
        return judged(place, place.board.events())


def judged(place: Place, events: list[Event]) -> Away:
    motor = [event for event in events if event.is_motor]
    first = next((at for at, event in enumerate(motor) if event.is_stop), len(motor))
    times = place.box.show(UNIT, "InactiveEnterTimestampMonotonic", "ActiveEnterTimestampMonotonic")
    ended_us, ready_us = (int(times[f"{state}EnterTimestampMonotonic"]) for state in ("Inactive", "Active"))
    moved = sum(any(event.speeds) for event in motor[first:])
    still = first < len(motor) and not any(place.board.wheels())
    return Away(len(motor) - first, moved, still, (ready_us - ended_us) / 1e6)


@contextlib.contextmanager
def driving(place: Place) -> Iterator[None]:
    """The wheels turn, and a program goes on commanding whatever happens to the service."""
    place.box.write(DRIVER, (ROOT / "bench/service_driver.py").read_text())
    words = place.box.entering("/opt/failstop/bin/python3", DRIVER, "failstop")
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdin is not None
        assert client.stdout is not None
        client.stdin.write("enable\n")
        client.stdin.flush()
        answer = client.stdout.readline().strip()
        if answer != "done":
            raise BenchError(f"the program that is to drive can't: {answer or 'it has ended'}")
        place.board.wait_wheels(True, 5.0)
        try:
            yield
            if client.poll() is not None:
                raise BenchError("the program that is to go on commanding has ended")
        finally:
            client.kill()


def gone(place: Place, before: set[str]) -> list[stats.Row]:
    """A removal while a program drives, and a purge: what they leave."""
    progress("removing")
    with driving(place):
        place.board.events()
        place.dpkg("-r", "failstop")
        motor = [event for event in place.board.events() if event.is_motor]
        still = bool(motor) and motor[-1].is_stop and not any(place.board.wheels())
    left = sorted(path for path in place.files() - before if not path.startswith(KEPT))
    rows = [
        verdict("a removal stops the wheels", [] if still else ["they turn"]),
        verdict("a removal leaves settings, incidents and the user alone", left),
        verdict("and it leaves these", [path for path in KEPT if not place.box.path(path).exists()]),
    ]
    progress("purging")
    place.dpkg("-P", "failstop")
    left = sorted(place.files() ^ before)
    known = place.box.run("dpkg-query", "--show", "failstop", check=False).stdout.split()
    rows.append(verdict("a purge leaves nothing", [*left, *place.accounts(), *known]))
    processes = place.box.run("pgrep", "--full", "/opt/failstop", check=False).stdout.split()
    return [*rows, verdict("and no process", processes)]


def another_python(package: Path, suite: str) -> list[stats.Row]:
    """The next Debian's Python takes the place of the system's while a program drives: the wheels are stopped, and what
    runs afterwards runs on the new one. Raises BenchError, ContainerMissing."""
    was, following = debian.SUITES[suite].python, debian.SUITES[FOLLOWING[suite]]
    change = f"{debian_tests.title(suite)}: Python {was} becomes {following.python}"
    with machine(debian_tests.booted(suite)) as place:
        progress(change)
        script = FETCH.format(suite=suite, following=following.name)
        done = debian.run(debian_tests.booted(suite), script, place.packages, FETCHED_S)
        if done.returncode:
            raise BenchError(f"the Python of {following.name} can't be fetched: {done.stdout[-2000:]}")
        fetched = [f"/packages/{path.name}" for path in sorted(place.packages.glob("*.deb"))]
        shutil.copy(package, place.packages / "new.deb")
        place.box.write(SETTINGS, f'[device]\npath = "{BOARD}"\n')
        place.dpkg("-i", "/packages/new.deb")
        place.box.wait(UNIT, 60.0, **READY)
        wrong = [f"{name} before" for name in interpreters(place) if name != f"python{was}"]
        words = ("env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "install", "--yes", "--no-install-recommends")
        with driving(place):
            place.board.events()
            place.box.run(*words, *fetched, timeout_s=CHANGED_S)
            place.box.wait(UNIT, 60.0, **READY)
            away = judged(place, place.board.events())
        wrong += [f"{name} after" for name in interpreters(place) if name != f"python{following.python}"]
        compiled = f"__init__.cpython-{following.python.replace('.', '')}.pyc"
        if not place.box.path(f"/opt/failstop/site-packages/failstop/__pycache__/{compiled}").exists():
            wrong.append(f"no {compiled}")
        place.dpkg("-P", "failstop")
        wrong += ["/opt/failstop stays"] * place.box.path("/opt/failstop").exists()
    return [
        verdict(f"{change}: the wheels are stopped", [] if away.stopped else ["they turn"]),
        stats.count(f"{change}: motion frames after the stop", away.moved, away.frames),
        verdict(f"{change}: what runs, runs on it", wrong),
    ]


def interpreters(place: Place) -> set[str]:
    """The names of the programs that the service's processes are."""
    return {os.path.basename(os.readlink(f"/proc/{pid}/exe")) for pid in place.box.pids(UNIT)}


def upgrade_rows(upgrades: list[Away]) -> list[stats.Row]:
    """Rows of the board's word on the wheels and systemd's on the service's absence."""
    away = sorted(upgrade.away_s for upgrade in upgrades)
    told = ", ".join(f"{seconds:.1f}" for seconds in away)
    numbers = {"away_s": away}
    return [
        stats.count(
            "upgrades in which the wheels were not stopped", sum(not one.stopped for one in upgrades), len(upgrades)
        ),
        stats.count(
            "motion frames after the stop, in upgrades",
            sum(one.moved for one in upgrades),
            sum(one.frames for one in upgrades),
        ),
        stats.Row(
            "how long an upgrade keeps the service away", f"{told} s", f"< {AWAY_S:g} s", away[-1] < AWAY_S, numbers
        ),
    ]


def verdict(measure: str, wrong: list[str]) -> stats.Row:
    """A row of what is wrong: nothing."""
    return stats.Row(measure, "; ".join(wrong[:5]) or "yes", "yes", not wrong, {"wrong": wrong})


if __name__ == "__main__":
    sys.exit(main())
