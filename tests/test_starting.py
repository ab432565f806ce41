"""Tests that `make quick` leaves out: those that may start a process, found by what they import."""

import os
from pathlib import Path

import pytest

from tests.support import starting

CONFTEST = """
from failstop_lab.trial import Trial
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
    "forks": "import os\ndef work(): os.fork()\n",
    "far": "from .forks import work\n",
    "round": "from tests.invented import pure\n",
    "pure": "import tests.invented.round\n",
    "conftest": CONFTEST,
}


STARTS = [
    "import subprocess\n",
    "import os\nos.fork()\n",
    "from failstop_lab import trial\n",
    "from failstop_lab.trial import Trial as Fine\n",
    "def test():\n    from failstop_lab.sim import client\n",
    "from tests.invented import far\n",
    "from .far import work\n",
    "def test(trial): ...\n",
    "def test(driving): ...\n",
    "@pytest.mark.usefixtures('driving')\ndef test(): ...\n",
]
STARTS_NONE = ["import os\n", "from .pure import work\n", "def test(still): ...\n"]


@pytest.mark.parametrize("source", [*STARTS, *STARTS_NONE])
def test_a_file_that_may_start_a_process(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starting, "ROOT", tmp_path)
    starting._files.cache_clear()
    folder = tmp_path / "tests/invented"
    folder.mkdir(parents=True)
    for name, text in {**HELPERS, "test_it": source}.items():
        (folder / f"{name}.py").write_text(text)
    assert starting.starts(folder / "test_it.py") is (source in STARTS)


def test_the_interpreter_tells_of_every_start(request: pytest.FixtureRequest) -> None:
    tests = Path(__file__).parent
    starting._files.cache_clear()
    assert not starting.starts(tests / "procs/test_gate_core.py")
    assert starting.starts(tests / "e2e/test_service.py")
    if request.config.getoption("quick"):
        with pytest.raises(pytest.fail.Exception, match="this test starts a process"):
            getattr(os, "posix_spawn")("/bin/true", ["true"], {})  # noqa: B009
