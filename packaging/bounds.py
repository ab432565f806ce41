"""`make bounds`: the quick tests with the oldest versions that pyproject.toml allows, on the oldest Python here; then
with the newest, on the newest Python.

Wheels alone: a bound without one is not tested by anybody, and is named by the resolver as one that can't be met.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import versions

ROOT = Path(__file__).resolve().parents[1]
TRIED = (("oldest", "lowest-direct", versions.VERSIONS), ("newest", "highest", versions.VERSIONS[::-1]))
"""A name, uv's word for it, and the Pythons in the order of preference."""
SHOWN = ("numpy", "posix-ipc", "pyserial", "msgpack", "psutil", "paho-mqtt", "prometheus-client", "segno", "tornado")


def environment() -> dict[str, str]:
    """For every step: quiet, and with compiled modules kept."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def steps(at: Path, resolution: str, interpreter: str) -> list[tuple[str, ...]]:
    """The commands that install it and run the tests, each with what it says only where it fails."""
    uv, python = str(Path(sys.executable).with_name("uv")), str(at / "bin/python")
    install = (uv, "pip", "install", "--quiet", "--python", python, "--only-binary", ":all:", "--no-binary", "failstop")
    editable = ("--config-settings", "editable_mode=compat", "--editable", ".[test]", "--editable", "lab")
    pytest = (python, "-m", "pytest", "-o", f"cache_dir={at / 'pytest'}", *versions.QUICK, "--numprocesses", "0")
    return [
        (interpreter, "-m", "venv", "--clear", str(at)),
        (*install, "--resolution", resolution, *editable),
        pytest,
    ]


def main(at: Path) -> int:
    """Both, one after the other; exit code 1 when one fails."""
    wrong = 0
    for name, resolution, order in TRIED:
        start_s = time.monotonic()
        found = [(each, path) for each in order if (path := versions.find(each, dict(os.environ)))]
        version, interpreter = found[0] if found else ("here", sys.executable)
        place = at / name
        for step in steps(place, resolution, interpreter):
            done = subprocess.run(step, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
            if done.returncode:
                print(f"{done.stdout[-8000:]}{done.stderr[-4000:]}", file=sys.stderr)
                break
        ask = "import importlib.metadata as m, sys; print(*(f'{n} {m.version(n)}' for n in sys.argv[1:]), sep=', ')"
        told = subprocess.run([place / "bin/python", "-c", ask, *SHOWN], capture_output=True, text=True, check=False)
        verdict = "FAILED" if done.returncode else "good"
        print(
            f"{name}, Python {version}: {verdict}, {time.monotonic() - start_s:.0f} s ({told.stdout.strip()})",
            flush=True,
        )
        wrong += bool(done.returncode)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve()))
