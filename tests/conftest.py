"""Places of every test's own: nothing that is installed or runs on the machine is read, and nothing is left there."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from failstop.files import root
from failstop_lab.machine.kernel import running_machines
from tests.support import starting

# A loaded machine is no failure: the time limits are pytest's.
settings.register_profile("failstop", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("quick", settings.get_profile("failstop"), max_examples=10)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the option of `make quick`."""
    parser.addoption(
        "--quick", action="store_true", help="only the tests that start no process (tests/support/starting.py)"
    )


def pytest_configure(config: pytest.Config) -> None:
    """With --quick little is tried of each property, and no process is started."""
    settings.load_profile("quick" if config.getoption("quick") else "failstop")
    if config.getoption("quick"):
        sys.addaudithook(_refuse)
        # Without its list of fonts matplotlib starts a process. Here it never has one, so that a test which draws fails
        # on every machine if it is not marked.
        fonts = tempfile.TemporaryDirectory()
        config.add_cleanup(fonts.cleanup)
        os.environ["MPLCONFIGDIR"] = fonts.name


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out what --quick does not want, unread."""
    wanted = not config.getoption("quick") or collection_path.suffix != ".py" or not starting.starts(collection_path)
    return None if wanted else True


def pytest_collection_finish() -> None:
    """Keep the facts of the sources, and take the modules of all tests, which stay, out of the garbage collector."""
    starting.keep()
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """With --quick, a test that starts a process all the same fails."""
    _quick.append(item.config.getoption("quick"))
    try:
        return (yield)
    finally:
        _quick.clear()


_quick: list[bool] = []


def _refuse(event: str, _: object) -> None:
    if event in starting.EVENTS and any(_quick):
        pytest.fail(f"{event}: this test starts a process: mark it `starts`, or see tests/support/starting.py")


LONGEST = (
    *("lab/prove/test_prove.py", "lab/faults/test_table.py", "systemd/test_install.py", "model/test_model.py"),
    *(
        "lab/machine/test_single_faults.py",
        "docs/test_docs.py",
        "systemd/test_service.py",
        "lab/prove/test_random_runs.py",
    ),
    *("ros2/test_arm_live.py", "incidents/test_live.py", "web/test_sockets.py", "lab/prove/test_arm.py"),
    *("board/test_proofs.py", "e2e/test_hostile_clients.py", "e2e/test_package.py", "docs/test_readme.py"),
    *("lab/machine/test_both_worlds.py", "cli/test_teleop.py", "ros2/test_driving.py", "e2e/test_kills.py"),
)
"""Files of tests by how long they take, as `pytest --durations=0` has it, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, then the others with slow tests: a worker that gets one last is waited for by all others."""
    here = Path(__file__).parent
    order = {here / name: place for place, name in enumerate(LONGEST)}
    if gone := [path for path in order if not path.exists()]:
        raise pytest.UsageError(f"LONGEST names files that are not there: {gone}")
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: order.get(item.path, len(order) + (item.path not in slow)))


@pytest.fixture(autouse=True)
def _no_machine_is_left() -> Iterator[None]:
    """The simulated machines that a test made end with it: their threads would keep them in memory."""
    before = set(running_machines)
    yield
    for machine in set(running_machines) - before:
        machine.end()


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """A pipe of the kernel's own: its end to read, its end to write."""
    ends = os.pipe()
    yield ends
    for fd in ends:
        os.close(fd)


@pytest.fixture(scope="session", autouse=True)
def _interruptible() -> None:
    """A shell's background job ignores Ctrl-C, and would hand that on to every command that a test interrupts."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def _own_places() -> Iterator[None]:
    """The directories of state, runtime and settings, for this process and for all that it starts; gone afterwards.

    Below /var/tmp, because every user must be able to reach a stop pipe, and what lies below /tmp is private.
    """
    base = Path(tempfile.mkdtemp(prefix=f"failstop-tests-{os.getpid()}-", dir="/var/tmp"))
    for place in (base, base / "run"):
        place.mkdir(exist_ok=True)
        place.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(root.VARIABLE, str(base))
        patch.setenv("XDG_STATE_HOME", str(base / "home"))
        for variable in ("STATE_DIRECTORY", "XDG_RUNTIME_DIR"):
            patch.delenv(variable, raising=False)
        yield
    shutil.rmtree(base, ignore_errors=True)
