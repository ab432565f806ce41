"""The Debian package on its way out, or back to an older one, and where systemd does not run."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator

import pytest

from failstop.lab.sim.client import SimBoard
from failstop.lab.trial import wait_for
from tests.support.pages import ROOT

from .installing import LINK, SETTINGS, Place

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]


def test_a_way_back_to_a_package_that_asks_says_the_answer_and_an_option_answers(
    place: Place, package: str, asking: str
) -> None:
    place.plug()
    place.dpkg("-i", package)
    mine = f'# mine\n[device]\npath = "{LINK}"\n'
    place.box.path(SETTINGS).write_text(mine)
    said = place.dpkg("-i", asking, code=1)  # nobody is there to answer
    assert "*** failstop.toml" in said
    assert "the service is down until this ends; if dpkg asks about failstop.toml, N keeps your settings" in said
    assert not place.ready()
    assert "force-confold" in (ROOT / "docs/install.md").read_text()
    place.dpkg("-i", package)
    place.dpkg("--force-confold", "-i", asking)
    assert place.ready()
    assert place.settings() == mine
    place.box.run("dpkg", "--purge", "failstop")


@contextlib.contextmanager
def by_hand(place: Place, name: str) -> Iterator[None]:
    """A service that root has started from this checkout, on a board of its own."""
    with SimBoard(place.packages.parent / "board" / name, mode=0o666):
        place.box.write(f"/tmp/{name}.toml", f'[device]\npath = "/board/{name}"\n')
        words = ("-m", "failstop", "run", "--name", name, "--config", f"/tmp/{name}.toml")
        running = place.box.entering("env", f"PYTHONPATH={ROOT}", sys.executable, *words)
        with subprocess.Popen(running, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as service:
            try:
                yield
            finally:
                # The signal is for the supervisor: nsenter does not pass it on.
                place.box.run("sh", "-c", f"kill $(cat /run/failstop/{name}/lock)")
                service.wait(20)


def test_a_service_that_was_started_by_hand_outlives_a_removal(place: Place, package: str) -> None:
    """The pipe stays where its clients look for it."""
    place.plug()
    place.dpkg("-i", package)
    wait_for("the service to be ready", place.ready)
    pipe = place.box.path("/run/failstop/byhand/stop")
    with by_hand(place, "byhand"):
        wait_for("the pipe of the other service", pipe.exists)
        said = place.dpkg("-r", "failstop")
        assert "'byhand' was not started by a unit of the package, and goes on" in said
        assert pipe.exists()
        assert not place.box.path("/run/failstop/failstop").exists()
    place.dpkg("-i", package)
    place.dpkg("-r", "failstop")
    assert not place.box.path("/run/failstop").exists()


def test_an_installation_without_systemd_says_that_nothing_stops_the_wheels(place: Place, package: str) -> None:
    hidden = "mount -t tmpfs tmpfs /run/systemd && dpkg -i"
    said = place.box.run("unshare", "--mount", "sh", "-c", f"{hidden} {package}", timeout_s=90)
    assert "systemd does not run here, so nothing was started: NOTHING STOPS THE WHEELS" in said.stderr
    assert "failstop run --config /etc/failstop/failstop.toml" in said.stderr
    assert not place.ready()
