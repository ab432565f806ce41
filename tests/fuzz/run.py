"""`make fuzz`: each target under a fuzzer that looks which lines its input reaches (atheris), a minute each.

    python -m tests.fuzz.run [--seconds S] [TARGET ...]

What it has found stays in .fuzz/TARGET, so that the next run goes on from there. An input that fails is written to
tests/fuzz/found/TARGET-...: `make test` tries all that are there, so mend what fails and commit both. Exit code 1 then.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOUND = Path(__file__).resolve().parent / "found"
CORPUS = ROOT / ".fuzz"
LONGEST = 4096
"""Bytes of an input."""


def one(name: str, arguments: list[str]) -> None:
    """Fuzz one target in this process, which libFuzzer ends."""
    import atheris

    with atheris.instrument_imports(include=["failstop"]):
        from tests.fuzz.targets import TARGETS

    target = TARGETS[name]
    for example in target.examples:
        (CORPUS / name / hashlib.sha256(example).hexdigest()[:16]).write_bytes(example)
    atheris.Setup([sys.argv[0], *arguments, str(CORPUS / name)], target.run)
    atheris.Fuzz()


def main() -> int:
    """Run them one after the other, and say what was found."""
    parser = argparse.ArgumentParser(description="Fuzz whatever reads bytes that others wrote.")
    parser.add_argument("--seconds", type=int, default=60, help="for each target (default: 60)")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("targets", nargs="*", help="default: all")
    arguments = parser.parse_args()
    if arguments.one:
        FOUND.mkdir(exist_ok=True)
        limits = [f"-max_total_time={arguments.seconds}", f"-max_len={LONGEST}", "-timeout=10", "-rss_limit_mb=1024"]
        one(arguments.one, [*limits, f"-artifact_prefix={FOUND}/{arguments.one}-"])
        return 0
    if not find_spec("atheris"):
        print("no atheris here: it has wheels for Python 3.11 and newer (make fuzz PYTHON=python3.11)", file=sys.stderr)
        return 1
    from tests.fuzz.targets import TARGETS

    failed = []
    for name in arguments.targets or TARGETS:
        (CORPUS / name).mkdir(parents=True, exist_ok=True)
        command = (sys.executable, "-m", "tests.fuzz.run", "--one", name, "--seconds", str(arguments.seconds))
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=dict(os.environ))
        last = [line for line in done.stderr.splitlines() if "exec/s" in line or line.startswith("Done")][-1:]
        print(f"{name}: {'FAILED' if done.returncode else 'good'}; {' '.join(last).strip()}", flush=True)
        if done.returncode:
            failed.append(name)
            print(*done.stdout.splitlines()[-40:], *done.stderr.splitlines()[-12:], sep="\n", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
