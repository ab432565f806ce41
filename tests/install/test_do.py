"""Steps done and undone in a directory: whole or not at all."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest

from failstop.install import InstallError
from failstop.install.do import NEW, OLD, Discard, Doer, Put, Run, Start, Step
from failstop.install.plan import Plan, uninstall
from tests.install.scene import (
    GROUP,
    INSTALLED,
    PASSWD,
    TEXTS,
    PlayedSystem,
    planned,
    snapshot,
)


def plan_for(root: Path, version: str = "1.0", units: tuple[str, ...] = ()) -> Plan:
    """The plan of an installation into a directory, as if these units ran there."""
    changed = {name: f"# {version}\n{text}" for name, text in TEXTS.items() if name.endswith(".service")}
    changed["failstop.catalog"] = f"{TEXTS['failstop.catalog']}{version}\n"
    return planned(PlayedSystem(root, running=units), texts=TEXTS | changed, version=version)


def do(root: Path, steps: tuple[Step, ...], system: PlayedSystem | None = None) -> PlayedSystem:
    system = system or PlayedSystem(root)
    assert Doer(system).do(steps) == []
    return system


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A system with a user database, and an administrator's own things."""
    (tmp_path / "etc/systemd/system").mkdir(parents=True)
    (tmp_path / "etc/systemd/system/own.service").write_text("[Service]\n")
    (tmp_path / "etc/passwd").write_text(PASSWD)
    (tmp_path / "etc/group").write_text(GROUP)
    return tmp_path


def test_what_is_installed_and_nothing_else(root: Path) -> None:
    before = snapshot(root)
    system = do(root, plan_for(root).steps)
    after = snapshot(root)
    assert {path: found for path, found in after.items() if path in before} == before
    files = {path for path, (kind, _, _) in after.items() if kind == "-" and path not in before}
    assert {path for path in files if not path.endswith(".pyc")} == INSTALLED
    assert len([path for path in files if path.endswith(".pyc")]) == 1, "compiled: the service may not write there"
    assert after["opt/failstop/bin/failstop"][1] == 0o755
    assert all(mode == 0o755 for path, (kind, mode, _) in after.items() if kind == "d" and path not in before)
    assert after["usr/local/bin/failstop"] == ("l", 0o777, b"/opt/failstop/bin/failstop")
    assert system.ran[-1] == "start failstop.service"


def test_installed_again_it_is_nothing_and_uninstalled_it_is_as_before(root: Path) -> None:
    before = snapshot(root)
    do(root, plan_for(root).steps)
    assert plan_for(root, units=("failstop.service",)).steps == ()
    do(root, uninstall(PlayedSystem(root)).steps)
    assert {path for path in snapshot(root) if path not in before} == {"etc/failstop", "etc/failstop/failstop.toml"}
    do(root, uninstall(PlayedSystem(root), purge=True).steps)
    assert snapshot(root) == before


def test_an_umask_does_not_hide_it_from_the_service(root: Path) -> None:
    mask = os.umask(0o077)
    try:
        do(root, plan_for(root).steps)
    finally:
        os.umask(mask)
    assert all(mode & 0o044 == 0o044 for path, (_, mode, _) in snapshot(root).items() if path.startswith("opt/"))


@pytest.mark.slow
@pytest.mark.parametrize("upgrade", [False, True], ids=["fresh", "upgrade"])
def test_a_failure_after_any_step_leaves_everything_as_it_was(root: Path, upgrade: bool) -> None:
    units: tuple[str, ...] = ()
    if upgrade:
        do(root, plan_for(root).steps)
        units = ("failstop.service",)
    before = snapshot(root)
    plan = plan_for(root, "2.0", units)
    assert len(plan.steps) > (8 if upgrade else 20)
    for failing in plan.steps:

        def fail(step: Step, failing: Step = failing) -> None:
            if step is failing:
                raise OSError("injected")

        with pytest.raises(InstallError, match="injected; everything is as it was before"):
            Doer(PlayedSystem(root)).do(plan.steps, fail)
        assert snapshot(root) == before, failing
    do(root, plan.steps)
    assert snapshot(root) != before


class FullDisk:
    """A function of `os` that works so many times, fails once, and works again."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str, allowed: int) -> None:
        self._real = getattr(os, name)
        self._left = allowed
        monkeypatch.setattr(os, name, self)

    def __call__(self, *words: object, **named: object) -> object:
        self._left -= 1
        if self._left == -1:
            raise OSError(28, "No space left on device")
        return self._real(*words, **named)

    @property
    def failed(self) -> bool:
        return self._left < 0


@pytest.mark.parametrize("name", ["replace", "rename", "symlink", "mkdir", "fsync", "fchmod"])
def test_a_failure_within_any_step_too(root: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    do(root, plan_for(root).steps)
    before = snapshot(root)
    plan = plan_for(root, "2.0", ("failstop.service",))
    for allowed in range(100):
        with monkeypatch.context() as patched:
            disk = FullDisk(patched, name, allowed)
            try:
                Doer(PlayedSystem(root)).do(plan.steps)
            except InstallError as failure:
                said = str(failure)
        if not disk.failed:
            break
        assert "No space left on device; everything is as it was before" in said
        assert snapshot(root) == before, (name, allowed)
    assert 0 < allowed < 100
    assert snapshot(root) != before


def test_a_failing_command_undoes_what_was_before_it_and_starts_the_old_service_again(root: Path) -> None:
    do(root, plan_for(root).steps)
    before = snapshot(root)
    system = PlayedSystem(root, failing="start failstop.service")
    with pytest.raises(InstallError, match=r"^start failstop.service: start: no; everything is as it was before$"):
        do(root, plan_for(root, "2.0", ("failstop.service",)).steps, system)
    assert snapshot(root) == before
    assert system.ran[0] == "systemctl stop failstop.service"
    told = system.ran[system.ran.index("start failstop.service") + 1 :]
    assert told == [
        "systemctl stop failstop.service",
        "systemctl daemon-reload",
        "systemctl start --no-block failstop.service",
    ], "the old version's, with the old files back and read"


def test_ctrl_c_is_a_failure_too(root: Path) -> None:
    before = snapshot(root)

    def interrupt(step: Step) -> None:
        if step.subject == "/opt/failstop":
            raise KeyboardInterrupt

    with pytest.raises(InstallError, match="interrupted; everything is as it was before"):
        Doer(PlayedSystem(root)).do(plan_for(root).steps, interrupt)
    assert snapshot(root) == before


def test_what_cannot_be_changed_back_is_named(root: Path) -> None:
    steps = (
        Put("create", "/new/file", content=b""),
        Run("run", "something", words=("true",), undo=("undo-it",)),
        Start("start", "undo-it-too"),
    )
    said = r"^start undo-it-too: start: no; this could NOT be changed back: undo-it: no$"
    with pytest.raises(InstallError, match=said):
        Doer(PlayedSystem(root, failing="undo-it")).do(steps)
    assert not (root / "new").exists(), "the rest is"


def test_a_new_directory_that_somebody_else_has_filled_is_named(root: Path) -> None:
    def fill(step: Step) -> None:
        (root / "new/theirs").touch()
        raise OSError("injected")

    with pytest.raises(InstallError, match=r"could NOT be changed back: .*not empty.*/new"):
        Doer(PlayedSystem(root)).do([Put("create", "/new/file", content=b"")], fill)
    assert os.listdir(root / "new") == ["theirs"]


def test_a_users_file_that_somebody_else_changed_meanwhile_stays(root: Path) -> None:
    passwd = root / "etc/passwd"

    def other(step: Step) -> None:
        with passwd.open("a") as file:
            file.write("somebody:x:\n")
        raise OSError("injected")

    steps = [Run("create", "user", "", ("systemd-sysusers",), changes=("/etc/passwd", "/etc/shadow"))]
    passwd.write_text("")
    with pytest.raises(InstallError, match=r"could NOT be changed back: .*/etc/passwd was changed by somebody else"):
        Doer(PlayedSystem(root)).do(steps, other)
    assert passwd.read_text() == PASSWD + "somebody:x:\n"


def test_a_users_file_that_a_program_has_changed_is_put_back_with_its_rights(root: Path) -> None:
    shadow = root / "etc/shadow"
    shadow.write_text("old")
    shadow.chmod(0o640)
    before = snapshot(root)

    class Writing(PlayedSystem):
        def run(self, words: object, accepted: object = (0,)) -> None:
            shadow.unlink()
            shadow.write_text("new")
            raise InstallError("half of it")

    with pytest.raises(InstallError, match="half of it; everything is as it was before"):
        Doer(Writing(root)).do([Run("create", "user", "", ("x",), changes=("/etc/shadow",))])
    assert snapshot(root) == before


def test_remains_of_a_power_failure_do_not_matter(root: Path) -> None:
    for name in (f"failstop{NEW}", f"failstop{OLD}"):
        (root / "opt" / name / "lib").mkdir(parents=True)
    do(root, plan_for(root).steps)
    assert sorted(os.listdir(root / "opt")) == ["failstop"]


def test_a_failure_does_not_bring_back_what_a_power_failure_left(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    do(root, plan_for(root).steps)
    before = snapshot(root)
    (root / "opt" / f"failstop{OLD}/lib").mkdir(parents=True)
    steps = plan_for(root, "2.0").steps
    FullDisk(monkeypatch, "mkdir", 0)
    with pytest.raises(InstallError, match=r"replace /opt/failstop: .*No space left"):
        Doer(PlayedSystem(root)).do(steps)
    monkeypatch.undo()
    assert snapshot(root) == before


def test_a_directory_with_something_of_somebody_else_stays(root: Path) -> None:
    do(root, plan_for(root).steps)
    (root / "usr/local/lib/systemd/catalog/other.catalog").write_text("other")
    do(root, uninstall(PlayedSystem(root)).steps)
    assert (root / "usr/local/lib/systemd/catalog/other.catalog").exists()
    assert not (root / "usr/local/bin").exists()


def test_a_directory_is_removed_when_all_else_is_done(root: Path) -> None:
    """What nothing brings back is there until then."""
    (root / "var/lib/failstop/front/incidents").mkdir(parents=True)
    (root / "var/lib/failstop/front/incidents/one").write_text("1")
    (root / "var/lib/failstop/log").symlink_to("front")
    before = snapshot(root)
    steps = (Discard("remove", "/var/lib/failstop"), Run("run", "no", "", ("no",)))
    with pytest.raises(InstallError, match="everything is as it was before"):
        Doer(PlayedSystem(root, failing="no")).do(steps)
    assert snapshot(root) == before
    do(root, steps)
    assert set(before) - set(snapshot(root)) == {path for path in before if path.startswith("var/lib/failstop")}


def test_files_and_links_over_one_another(root: Path) -> None:
    (root / "etc/a").symlink_to("/nowhere")
    (root / "etc/b").write_text("b")
    (root / "etc/d").write_text("d")
    (root / "etc/d").chmod(0o640)
    before = snapshot(root)
    steps = (
        Put("create", "/etc/a", content=b"new"),
        Put("create", "/etc/b", content="/there"),
        Put("create", "/etc/d", content=b"new"),
        Put("remove", "/etc/c"),
    )
    with pytest.raises(InstallError):
        Doer(PlayedSystem(root, failing="no")).do((*steps, Run("run", "no", "", ("no",))))
    assert snapshot(root) == before
    do(root, steps)
    assert snapshot(root)["etc/a"][2] == b"new"
    assert snapshot(root)["etc/b"] == ("l", 0o777, b"/there")


def test_an_installation_that_lost_its_power_can_be_done_again_or_taken_away(root: Path) -> None:
    before = snapshot(root)
    plan = plan_for(root)
    at = next(index for index, step in enumerate(plan.steps) if step.subject.endswith(".service"))
    do(root, plan.steps[: at + 1])
    partly = snapshot(root)
    do(root, plan_for(root).steps)
    assert plan_for(root, units=("failstop.service",)).steps == ()
    for path in sorted(set(snapshot(root)) - set(partly), reverse=True):
        target = root / path
        target.rmdir() if target.is_dir() and not target.is_symlink() else target.unlink()
    do(root, uninstall(PlayedSystem(root)).steps)
    assert set(snapshot(root)) - set(before) <= {"etc/failstop"}


def test_a_second_ctrl_c_does_not_end_the_undoing(root: Path) -> None:
    before = snapshot(root)
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored

    class Impatient(PlayedSystem):
        def run(self, words: object, accepted: object = (0,)) -> None:
            if words == ("systemctl", "daemon-reload"):
                self.ran.append("killed")
                # To this thread: a process's signal goes to any thread, and numpy's and xdist's do not block it.
                signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    system = Impatient(root)
    # The reload is undone with a reload, in which the second signal comes.
    with pytest.raises(InstallError, match=r"daemon-reload: interrupted; everything is as it was before"):
        Doer(system).do(plan_for(root).steps)
    signal.signal(signal.SIGINT, kept)
    assert system.ran == ["killed", "killed"]
    assert snapshot(root) == before
