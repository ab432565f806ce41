"""`make versions`: the quick tests on the oldest and the newest Python that failstop runs on, where there are such.

PyPI has no interpreters, and a Debian has one: they are looked for on the path, and where pyenv and uv keep theirs.
What is missing is said, and is no failure.
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

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.10", "3.13")
QUICK = ("--quick", "--quiet", "-m", "not slow and not alone and not starts")
AGAIN = ("--last-failed", "--last-failed-no-failures", "none")
"""A test that fails beside others is tried again by itself, as `make test` does."""
ASK = "import sys, venv, ensurepip; print('{}.{}'.format(*sys.version_info))"


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


def run(version: str, interpreter: str, at: Path) -> tuple[bool, str]:
    """The quick tests there, in an environment of their own: whether they pass, and what they said."""
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

    good = not code(interpreter, "-m", "venv", "--clear", str(at / version)) and not code(*pip, *editable)
    if good:
        # Two versions at once, each in one process: there are as few processors.
        found = code(*pytest, "--numprocesses", "0")
        good = (code(*pytest, "--numprocesses", "0", *AGAIN) if found == 1 else found) == 0
    return good, "".join(said)


def tried(version: str, at: Path) -> tuple[bool, str]:
    """Whether a version is good, or not here; and a line for people."""
    start_s = time.monotonic()
    interpreter = find(version, dict(os.environ))
    if interpreter is None:
        return True, f"python {version}: none here (on the path, of pyenv, of uv): not tried"
    good, said = run(version, interpreter, at)
    line = f"python {version}: {'good' if good else 'FAILED'}, {time.monotonic() - start_s:.0f} s"
    return good, line if good else f"{said}\n{line}"


def main(at: Path) -> int:
    """All versions at once, since each waits for the network first; exit code 1 when one fails."""
    with ThreadPoolExecutor() as pool:
        found = list(pool.map(lambda version: tried(version, at), VERSIONS))
    print(*(line for _, line in found), sep="\n")
    return int(not all(good for good, _ in found))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve()))
