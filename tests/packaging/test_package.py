"""Content of the Debian package, and its maintainer."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from bench import BenchError
from failstop.cli.commands import config
from failstop.doctor.port import LINK
from failstop.policy.settings import BY_KEY
from failstop_lab.pages import completion, man
from tests.packaging import life
from tests.support.deb import build, tree
from tests.support.pages import ROOT

ALWAYS = ("failstop.service", "failstop-sleep.service")
"""Enabled with the package; the others by who wants them."""


@pytest.fixture(scope="module")
def files() -> dict[str, str]:
    found: dict[str, str] = build.files()
    return found


def test_completion_is_where_the_shells_look(files: dict[str, str]) -> None:
    assert {shell: files[place] for shell, place in build.COMPLETIONS.items()} == {
        shell: completion.script(shell) for shell in completion.SHELLS
    }
    assert [path for path, text in files.items() if text == man.page()] == ["usr/share/man/man1/failstop.1.gz"]


def test_every_file_of_systemd_is_in_it(files: dict[str, str]) -> None:
    """Units that are started on request too."""
    there = {
        path.name: path.read_text() for path in (ROOT / "systemd").iterdir() if path.is_file() and path.suffix != ".md"
    }
    units = {path.rpartition("/")[2]: text for path, text in files.items() if path.startswith(build.UNITS)}
    assert units | {name: files[place] for name, place in build.PLACES.items()} == there
    assert all("/opt/failstop/bin/failstop " in text for text in units.values())
    assert tree.PREFIX == "/opt/failstop"


def wanted(text: str) -> bool:
    """Something starts this unit where it is enabled."""
    return "\nWantedBy=" in text


@pytest.mark.starts
def test_the_scripts_know_every_unit(files: dict[str, str]) -> None:
    scripts = {name: files[f"DEBIAN/{name}"] for name in build.SCRIPTS[:4]}
    units = {path.rpartition("/")[2]: text for path, text in files.items() if path.startswith(build.UNITS)}
    for unit, text in units.items():
        name = unit.removesuffix(".service")
        assert (unit in scripts["postrm"]) == (unit in ALWAYS), unit
        assert unit.replace("@", "@*") in scripts["prerm"] or not wanted(text) or name == "failstop-sleep", unit
        if wanted(text) and unit not in ALWAYS:
            assert unit.replace("@", "@*") in scripts["postinst"]
            assert name in scripts["prerm"].partition("for unit in")[2]
    for name, text in [*build.scripts("failstop-lab").items(), *scripts.items()]:
        subprocess.run(["sh", "-n"], input=text, text=True, check=True)
        assert "set -e\n" in text, name


def edited(example: str, script: str) -> str:
    """The settings after what a script of the package does to them where the udev rule has named a board."""
    words = re.findall(r"\[ ! -e (\S+) \] \|\| sed -i '([^']+)'", script)
    [(link, expression)] = words
    assert link == LINK
    done = subprocess.run(["sed", expression], input=example, capture_output=True, text=True, check=True)
    return done.stdout


@pytest.mark.starts
def test_the_board_s_name_by_the_rule_is_what_new_settings_say(files: dict[str, str]) -> None:
    """A number may be another's after a replug."""
    example = config.example()
    said = edited(example, files["DEBIAN/postinst"])
    default = f'#device.path = "{BY_KEY["device.path"].default}"\n'
    assert said == example.replace(default, f'device.path = "{LINK}"\n', 1) != example


@pytest.mark.starts
@pytest.mark.parametrize("right", [True, False])
def test_the_robot_that_does_not_start_is_named_with_its_own_file(
    files: dict[str, str], tmp_path: Path, right: bool
) -> None:
    """And the others are started. `right`: the service's user can read its settings file, which is right."""
    [start] = re.findall(r"^start\(\) \{\n.*?^\}\n", files["DEBIAN/postinst"], re.MULTILINE | re.DOTALL)
    for name, refuses in (
        ("deb-systemd-invoke", "failstop@front.service"),
        ("runuser", "" if right else "failstop"),
    ):
        program = tmp_path / name
        program.write_text(f'#!/bin/sh\necho "{name} $*" >>{tmp_path}/calls\n[ "$2" != "{refuses}" ]\n')
        program.chmod(0o755)
    wants = tmp_path / "multi-user.target.wants"
    wants.mkdir()
    for robot in ("front", "rear"):
        (wants / f"failstop@{robot}.service").symlink_to("/nowhere")
    script = f"set -e\nfailstop={tmp_path}/failstop\nsettings=/etc/failstop/failstop.toml\n{start}start {tmp_path}\n"
    environ = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["sh", "-c", script], env=environ, capture_output=True, text=True, check=True)
    file = "/etc/failstop/front.toml"
    why = (
        f": is the board plugged in, at the device.path of {file}?"
        if right
        else f", because of {file}: see the line above"
    )
    assert done.stderr == f"failstop@front does not run yet{why}\n"
    assert (tmp_path / "calls").read_text().splitlines() == [
        "deb-systemd-invoke start failstop.service",
        "deb-systemd-invoke start failstop@front.service",
        f"runuser -u failstop -- {tmp_path}/failstop config --check {file}",
        "deb-systemd-invoke start failstop@rear.service",
    ]


def prerm(files: dict[str, str], why: str, systemctl: str, folder: Path) -> tuple[str, list[str]]:
    """Run the part of prerm that stops the services. Returns what it says, and the calls of systemctl. `systemctl`: the
    commands of a stand-in."""
    [block] = re.findall(r"\Aif \[ -d /run/systemd/system \].*?^fi\n", files["DEBIAN/prerm"].partition("set -e\n\n")[2],
                         re.MULTILINE | re.DOTALL)  # fmt: skip
    return run_with_systemctl(block, why, systemctl, folder)


def run_with_systemctl(script: str, why: str, systemctl: str, folder: Path) -> tuple[str, list[str]]:
    """Run a part of a maintainer script on a machine with the stand-in `systemctl`, whose /run is `folder`. Returns
    what it says, and the calls of systemctl. `why`: what dpkg calls the script for."""
    program = folder / "systemctl"
    program.write_text(f'#!/bin/sh\necho "$*" >>{folder}/calls\n{systemctl}')
    program.chmod(0o755)
    (folder / "systemd/system").mkdir(parents=True, exist_ok=True)
    (folder / "calls").write_text("")
    script = f"set -e\n{script.replace('/run/', f'{folder}/')}"
    environ = {"PATH": f"{folder}:{os.environ['PATH']}"}
    done = subprocess.run(["sh", "-c", script, "sh", why], env=environ, capture_output=True, text=True, check=True)
    return done.stderr, (folder / "calls").read_text().splitlines()


@pytest.mark.parametrize("failed", ["failstop@front.service", ""])
@pytest.mark.parametrize("why", ["remove", "upgrade"])
def test_a_stop_that_is_not_proven_is_named_when_nothing_goes_on_trying(
    files: dict[str, str], tmp_path: Path, why: str, failed: str
) -> None:
    lists = f'case "$*" in *state=failed*) echo "{failed} loaded failed failed failstop";; esac\n' if failed else ""
    text, calls = prerm(files, why, lists, tmp_path)
    told = f"failstop: the last stop of {failed} is not proven: if a wheel turns, use the POWER SWITCH\n"
    assert text == (told if failed else "")
    assert calls[-1].startswith("stop failstop-late.service"), "after they have been looked at"


@pytest.mark.parametrize(
    ("state", "starts"),
    [("failed", True), ("inactive", True), ("active", False), ("activating", False), ("deactivating", False)],
)
@pytest.mark.parametrize("name", ["", "@front"])
def test_after_an_upgrade_an_unwritten_stop_is_still_tried_unless_the_service_runs(
    files: dict[str, str], tmp_path: Path, name: str, state: str, starts: bool
) -> None:
    """`state`: the state of the service after the upgrade, as systemd reports it. The other robot's service was running
    all the time."""
    running = (f"failstop-late{name}.service", "failstop@rear.service")
    patterns = (running[0].replace("front", "*"), "failstop@*.service")
    there = "".join(
        f"case \"$*\" in *{pattern.replace('*', '[*]')}*) echo '{unit} loaded active running it';; esac\n"
        for unit, pattern in zip(running, patterns, strict=True)
    )
    systemctl = (
        f'case "$*" in *state=active,activating*)\n{there};; esac\n'
        f'[ "$1" != is-active ] || {{ echo {state}; exit 3; }}\n'
    )
    _, calls = prerm(files, "upgrade", systemctl, tmp_path)
    assert calls[-1].startswith("stop failstop-late.service")
    [resume] = re.findall(r"^resume\(\) \{\n.*?^\}\n", files["DEBIAN/postinst"], re.MULTILINE | re.DOTALL)
    _, calls = run_with_systemctl(f"{resume}resume\n", "configure", systemctl, tmp_path)
    asks = f"is-active failstop{name}.service"
    assert calls == ["start failstop@rear.service", asks, *[f"start {running[0]}"] * starts]
    assert run_with_systemctl(f"{resume}resume\n", "configure", systemctl, tmp_path) == ("", []), "only once"


def test_an_installation_by_an_older_version_is_not_overwritten(files: dict[str, str]) -> None:
    assert "/opt/failstop/install.json" in files["DEBIAN/preinst"]
    assert "sudo /usr/local/bin/failstop uninstall" in files["DEBIAN/preinst"]


@pytest.mark.starts
def test_the_maintainer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("GIT_CONFIG_NOSYSTEM", "1")
    both = {"DEBFULLNAME": "Anna Builder", "DEBEMAIL": "anna@example.org"}
    assert build.maintainer(both, tmp_path) == "Anna Builder <anna@example.org>"
    assert build.maintainer({}, tmp_path) == build.NOBODY
    assert build.maintainer({"DEBFULLNAME": "Anna"}, tmp_path) == build.NOBODY, "half of it is nobody"
    (tmp_path / ".gitconfig").write_text("[user]\nname = Bob\nemail = bob@example.org\n")
    assert build.maintainer({}, tmp_path) == "Bob <bob@example.org>"
    assert build.maintainer(both, tmp_path).startswith("Anna")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert build.maintainer({}, tmp_path) == build.NOBODY


def test_without_the_systems_python_the_build_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert build.main([], "/nowhere/python3") == 1
    assert "make deb PYTHON=/usr/bin/python3 VENV=.venv-deb" in capsys.readouterr().err


def test_the_pythons_that_a_package_is_for() -> None:
    assert build.needs(["3.11"]) == "python3 (>= 3.11), python3 (<< 3.12)"
    assert build.needs(["3.9", "3.10", "3.14"]) == "python3 (>= 3.9), python3 (<< 3.15)"


def test_of_a_release_a_machine_installs_what_is_for_it_and_the_robots_comes_first(tmp_path: Path) -> None:
    ours = life.architecture()
    for name in ("failstop-lab_0.2.0_all", f"failstop_0.2.0_{ours}", "failstop_0.2.0_other"):
        (tmp_path / f"{name}.deb").touch()
    found = life.newest(tmp_path)
    names = [path.stem for path in found]
    assert names == [f"failstop_0.2.0_{ours}", "failstop-lab_0.2.0_all", "failstop_0.2.0_other"]
    assert life.fitting(found, ours) == found[:2]
    found[0].unlink()
    with pytest.raises(BenchError, match=f"no package for {ours}"):
        life.newest(tmp_path)
