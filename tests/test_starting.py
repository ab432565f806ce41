"""Tests that `make quick` leaves out: those that may start a process, found by their imports."""

import os
from pathlib import Path

import pytest

from tests.support import starting

CONFTEST = """
from failstop.lab.trial import Trial
from invented import Still

@pytest.fixture
def trial():
    yield Trial()

@pytest.fixture
def still():
    return Still()

@pytest.fixture
def driving(trial):
    return trial
"""
HELPERS = {
    "tests/invented/forks.py": "import os\ndef work(): os.fork()\n",
    "tests/invented/far.py": "from .forks import work\n",
    "tests/invented/round.py": "from tests.invented import pure\n",
    "tests/invented/pure.py": "import tests.invented.round\n",
    "tests/invented/conftest.py": CONFTEST,
}


@pytest.mark.parametrize(
    ("source", "starts"),
    [
        ("import os\n", False),
        ("import subprocess\n", True),
        ("import os\nos.fork()\n", True),
        ("from failstop.lab import trial\n", True),
        ("from failstop.lab.trial import Trial as Fine\n", True),
        ("def test():\n    from failstop.lab.sim import client\n", True),
        ("from tests.invented import far\n", True),
        ("from .far import work\n", True),
        ("from .pure import work\n", False),
        ("def test(trial): ...\n", True),
        ("def test(driving): ...\n", True),
        ("@pytest.mark.usefixtures('driving')\ndef test(): ...\n", True),
        ("def test(still): ...\n", False),
    ],
)
def test_a_file_that_may_start_a_process(
    source: str, starts: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(starting, "ROOT", tmp_path)
    starting._files.cache_clear()
    for name, text in {**HELPERS, "tests/invented/test_it.py": source}.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert starting.starts(tmp_path / "tests/invented/test_it.py") is starts


def test_the_interpreter_tells_of_every_start(request: pytest.FixtureRequest) -> None:
    """The gate's core is quick, the service end to end is not, and a quick test that starts a process fails."""
    tests = Path(__file__).parent
    starting._files.cache_clear()
    assert not starting.starts(tests / "procs/test_gate_core.py")
    assert starting.starts(tests / "e2e/test_service.py")
    if request.config.getoption("quick"):
        with pytest.raises(pytest.fail.Exception, match="this test starts a process"):
            getattr(os, "posix_spawn")("/bin/true", ["true"], {})  # noqa: B009
