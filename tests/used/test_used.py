"""The suite does not depend on what is installed or runs on the machine, and leaves nothing there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from failstop.files import root

ROOT = Path(__file__).resolve().parents[2]
NAMESPACES = ("unshare", "--mount", "--pid", "--fork", "--kill-child=KILL", "--mount-proc")
PART = (
    "tests/incidents/test_find.py",
    "tests/shm/test_root.py",
    "tests/procs/telemetry/test_state_files.py",
    "tests/doctor/test_gathering.py::test_all_of_it_is_looked_at_without_a_port",
    "tests/cli/test_follow.py::test_there_must_be_one_at_first",
    "tests/cli/test_follow.py::test_an_end_and_a_start_anew",
    "tests/cli/test_follow.py::test_a_unit_counts_where_systemd_runs_and_has_it",
    "tests/lab/prove/test_settings.py",
    "tests/lab/prove/test_prove.py::test_without_the_word_nothing_is_written",
    # What takes its time there has nothing to do with the machine.
    "--deselect=tests/incidents/test_find.py::test_a_file_is_named_for_the_incident_or_as_asked",
)


def missing() -> str:
    """Why there can be no such machine here; empty: there can."""
    if os.geteuid():
        return "mounts of its own need root"
    done = subprocess.run([*NAMESPACES, "true"], capture_output=True, text=True, check=False)
    return done.stderr.strip()


@pytest.mark.slow
def test_a_part_of_it_on_a_used_machine(tmp_path: Path) -> None:
    if reason := missing():
        if os.environ.get("CI") == "true":
            pytest.fail(f"CI must run this; {reason}")
        pytest.skip(reason)
    own = (root.VARIABLE, "XDG_STATE_HOME", "PYTEST_ADDOPTS")
    environment = {
        **{name: value for name, value in os.environ.items() if name not in own and "XDIST" not in name},
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    base = tmp_path / "base"
    base.mkdir()
    pytest_ = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", f"--basetemp={base}/tests"]
    command = [*NAMESPACES, sys.executable, "-m", "tests.used.machine", str(base), *pytest_, *PART]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=110, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    assert " passed" in done.stdout
