"""`make versions`: the quick tests on the oldest and on the newest Python here that failstop runs on.

ALL=yes tries each. STEP=install only makes their environments, and STEP=test only tries them. PyPI has no
interpreters, and a Debian has one. They are looked for on the path, where pyenv and uv keep theirs, and where
`make interpreter` unpacks Debian's. A missing one is named, and is no failure.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import interpreter

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
QUICK = ("--quick", "--quiet", "-m", "not slow and not alone and not starts")
AGAIN = ("--last-failed", "--last-failed-no-failures", "none")
"""A test that fails beside others is tried again by itself, as `make test` does."""
STEPS = ("", "install", "test")
ASK = "import sys, venv, ensurepip; print('{}.{}'.format(*sys.version_info))"


def numbers(version: str) -> tuple[int, int]:
    """A version such as 3.9 as it is ordered: before 3.10."""
    major, minor = version.split(".")
    return int(major), int(minor)


def candidates(version: str, environment: dict[str, str]) -> Iterator[str]:
    """Where an interpreter of this version may be."""
    found = shutil.which(f"python{version}", path=environment.get("PATH"))
    if found:
        yield found
    home = Path(environment.get("HOME", "/root"))
    pyenv = Path(environment.get("PYENV_ROOT", home / ".pyenv"))
    uv = Path(environment.get("UV_PYTHON_INSTALL_DIR", home / ".local/share/uv/python"))
    for directory, pattern in ((pyenv / "versions", f"{version}.*"), (uv, f"cpython-{version}.*")):
        yield from (str(one / "bin/python3") for one in sorted(directory.glob(pattern)))
    yield str(interpreter.place(version))


def find(version: str, environment: dict[str, str]) -> str | None:
    """The first that is of this version, runs, and can make an environment; None: there is none."""
    for path in candidates(version, environment):
        try:
            done = subprocess.run([path, "-c", ASK], capture_output=True, text=True, timeout=60, check=False)
        except OSError:
            continue
        if done.returncode == 0 and done.stdout.strip() == version:
            return path
    return None


def run(version: str, python3: str, at: Path, step: str = "") -> tuple[bool, str]:
    """The quick tests there, in an environment of their own: whether they pass, and what they printed. `step`: only
    make the environment, or only try it; empty: both."""
    python = str(at / version / "bin/python")
    pip = (python, "-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check")
    editable = ("--config-settings", "editable_mode=compat", "--editable", ".[test]", "--editable", "lab")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    pytest = (python, "-m", "pytest", "-o", f"cache_dir={at / version / 'pytest'}", *QUICK)

    said: list[str] = []

    def code(*command: str) -> int:
        done = subprocess.run(command, cwd=ROOT, env=environment, check=False, capture_output=True, text=True)
        said.extend((done.stdout, done.stderr))
        return done.returncode

    good = step == "test" or (
        not code(python3, "-m", "venv", "--clear", str(at / version)) and not code(*pip, *editable)
    )
    if good and step != "install":
        # Two versions at once, each in one process: there are as few processors.
        found = code(*pytest, "--numprocesses", "0")
        good = (code(*pytest, "--numprocesses", "0", *AGAIN) if found == 1 else found) == 0
    return good, "".join(said)


def absent(version: str) -> str:
    """The line for a version that has no interpreter here."""
    advice = f"; next: make interpreter PYTHON_VERSION={version}" if version in interpreter.SUITES else ""
    return f"python {version}: not tried, because none was found (on the path, of pyenv, of uv){advice}"


def tried(version: str, python3: str, at: Path, step: str) -> tuple[bool, str]:
    """Whether a version is good, and a line for people."""
    start_s = time.monotonic()
    good, said = run(version, python3, at, step)
    verdict = ("installed" if step == "install" else "good") if good else "FAILED"
    line = f"python {version}: {verdict}, {time.monotonic() - start_s:.0f} s"
    return good, line if good else f"{said}\n{line}"


def main(at: Path, whole: bool = False, step: str = "") -> int:
    """Two versions at once, since each waits for the network first; exit code 1 when one fails. `whole`: every version
    that is here, not only the oldest and the newest. `step`: as for run()."""
    if step not in STEPS:
        print(f"there is no step {step}: use STEP=install, STEP=test or neither", file=sys.stderr)
        return 2
    here = {version: path for version in VERSIONS if (path := find(version, dict(os.environ)))}
    chosen = list(here) if whole else [*here][:1] + [*here][1:][-1:]
    with ThreadPoolExecutor(max_workers=2) as pool:
        runs = {version: pool.submit(tried, version, here[version], at, step) for version in chosen}
    found = {version: run.result() for version, run in runs.items()}
    for version in VERSIONS:
        if version in found:
            print(found[version][1])
        else:
            print(f"python {version}: not tried; ALL=yes tries it" if version in here else absent(version))
    return int(not all(good for good, _ in found.values()))


if __name__ == "__main__":
    words = set(sys.argv[2:])
    sys.exit(main(Path(sys.argv[1]).resolve(), "all" in words, " ".join(words - {"all"})))
