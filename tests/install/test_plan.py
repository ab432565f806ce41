"""What an installation would do, and what taking it away would: into a directory that is looked at and not changed."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from failstop.install import InstallError, plan
from failstop.install.do import Discard, Put, Run, Start, Step
from failstop.install.plan import Plan, Request, uninstall, uninstall_instance
from failstop.install.system import MANIFEST, PREFIX, Content, Manifest
from failstop.install.tree import Environment
from tests.install.scene import (
    EXAMPLE,
    GROUP,
    LIVE,
    PASSWD,
    TEXTS,
    PlayedSystem,
    bare,
    installed,
    planned,
    running,
    shown,
    snapshot,
)

SETTINGS = "/etc/failstop/failstop.toml"
RULE = "/etc/udev/rules.d/90-failstop.rules"
UNIT = "/etc/systemd/system/failstop.service"
WANTS = "/etc/systemd/system/multi-user.target.wants"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return bare(tmp_path)


def write(root: Path, path: str, text: str) -> None:
    place = root / path.lstrip("/")
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text)


def remarks(plan: Plan) -> dict[str, str]:
    return {step.subject: step.remark for step in plan.steps}


def put(plan: Plan, path: str) -> Content | Environment:
    [step] = [step for step in plan.steps if isinstance(step, Put) and step.subject == path]
    return step.content


def test_a_bare_machine_gets_everything_in_an_order_that_works(root: Path) -> None:
    before = snapshot(root)
    plan = planned(PlayedSystem(root))
    assert shown(plan) == [
        "create /opt/failstop",
        "create /etc/systemd/system/failstop.service",
        "create /etc/systemd/system/failstop@.service",
        "create /etc/systemd/system/failstop-sleep.service",
        "create /etc/systemd/system/failstop-late@.service",
        "create /etc/sysusers.d/failstop.conf",
        "create /etc/udev/rules.d/90-failstop.rules",
        "create /usr/local/lib/systemd/catalog/failstop.catalog",
        "create /usr/local/share/man/man1/failstop.1",
        "create /usr/local/share/bash-completion/completions/failstop",
        "create /usr/local/share/zsh/site-functions/_failstop",
        "create /usr/local/share/fish/vendor_completions.d/failstop.fish",
        "create /usr/local/bin/failstop",
        "create /etc/systemd/system/multi-user.target.wants/failstop.service",
        "create /etc/systemd/system/some.device.wants/failstop.service",
        "create /etc/systemd/system/sleep.target.wants/failstop-sleep.service",
        "create /etc/failstop/failstop.toml",
        "create user and group failstop",
        "run journalctl --update-catalog",
        "run systemctl daemon-reload",
        "run udevadm control --reload",
        "run udevadm trigger --subsystem-match=tty",
        "run udevadm trigger --subsystem-match=usb --attr-match=idVendor=1a86",
        "run udevadm settle --timeout=5",
        "check that the user failstop can run it",
        "start failstop.service",
    ]
    assert plan.restarts == ()
    assert snapshot(root) == before


def test_what_is_shown_of_the_steps(root: Path) -> None:
    found = remarks(installed(root))
    wants = "/etc/systemd/system/multi-user.target.wants/failstop.service"
    sleep = "/etc/systemd/system/sleep.target.wants/failstop-sleep.service"
    assert [found[path] for path in ("/usr/local/bin/failstop", wants, sleep)] == [
        "the command",
        "starts at boot",
        "before a sleep",
    ]
    assert found["user and group failstop"] == "the service runs as it; in the groups of dialout"
    assert remarks(uninstall(running(root)))[PREFIX] == "the Python environment"


def test_the_second_time_there_is_nothing_to_do(root: Path) -> None:
    installed(root)
    assert planned(running(root)).steps == ()


def test_an_installed_service_that_does_not_run_is_started(root: Path) -> None:
    installed(root)
    assert shown(planned(PlayedSystem(root))) == ["start failstop.service"]
    assert planned(PlayedSystem(root), dataclasses.replace(LIVE, start=False)).steps == ()


def test_another_version_is_replaced_with_the_service_stopped_first_and_started_last(root: Path) -> None:
    installed(root)
    newer = {**TEXTS, "failstop.service": "[Install]\nWantedBy=multi-user.target some.device\n"}
    plan = planned(running(root), texts=newer, version="2.0")
    assert plan.restarts == ("failstop.service",)
    assert shown(plan) == [
        "stop failstop.service",
        "replace /opt/failstop",
        "replace /etc/systemd/system/failstop.service",
        "run systemctl daemon-reload",
        "check that the user failstop can run it",
        "start failstop.service",
    ]
    stop = plan.steps[0]
    assert isinstance(stop, Run)
    assert stop.undo == ("systemctl", "start", "--no-block", "failstop.service")
    installed(root, texts=newer, version="2.0")
    assert planned(running(root), texts=newer, version="2.0").steps == ()


def test_what_no_service_reads_is_replaced_without_a_restart(root: Path) -> None:
    installed(root)
    plan = planned(running(root), texts=TEXTS | {"failstop.udev": "# other\n"})
    assert plan.restarts == ()
    assert "start failstop.service" not in shown(plan)
    assert f"replace {RULE}" in shown(plan)


def test_a_file_that_only_an_older_version_had_is_removed(root: Path) -> None:
    installed(root)
    manifest = Manifest.load((root / MANIFEST.lstrip("/")).read_bytes())
    old = "/etc/udev/rules.d/1-old"
    write(root, old, "old")
    write(root, MANIFEST, dataclasses.replace(manifest, files={**manifest.files, old: "0"}).dump().decode())
    plan = planned(PlayedSystem(root))
    assert f"remove {old}" in shown(plan)
    assert remarks(plan)[old] == "of another version"


def test_a_damaged_environment_or_unit_is_repaired(root: Path) -> None:
    installed(root)
    write(root, UNIT, "")
    assert f"replace {UNIT}" in shown(planned(PlayedSystem(root)))
    assert "replace /opt/failstop" not in shown(planned(PlayedSystem(root)))
    write(root, f"{PREFIX}/lib/module.py", "rot")
    assert "replace /opt/failstop" in shown(planned(PlayedSystem(root)))


def test_a_configuration_that_is_there_stays(root: Path) -> None:
    write(root, SETTINGS, 'device.path = "/dev/mine"\n')
    plan = planned(PlayedSystem(root))
    assert not [step for step in plan.steps if step.subject == SETTINGS]
    assert plan.notes == (f"{SETTINGS} is yours and stays as it is",)
    with pytest.raises(InstallError, match=r"failstop.toml says device.path = '/dev/mine': change it there"):
        planned(PlayedSystem(root), dataclasses.replace(LIVE, device="/dev/other"))
    assert planned(PlayedSystem(root), dataclasses.replace(LIVE, device="/dev/mine")).steps


def test_the_device_is_written_into_a_new_configuration_and_nothing_else_is_changed(root: Path) -> None:
    plan = planned(PlayedSystem(root), dataclasses.replace(LIVE, device="/dev/board"))
    assert put(plan, SETTINGS) == EXAMPLE.replace("/dev/ttyACM0", "/dev/board").encode()


def test_any_device_is_read_again_as_it_was_named(root: Path) -> None:
    device = '/dev/a "quoted" \\ bärd 🤖'
    installed(root, dataclasses.replace(LIVE, device=device))
    assert plan.configured_device(LIVE, PlayedSystem(root)) == device


def test_a_second_robot_is_an_instance_with_a_board_of_its_own(root: Path) -> None:
    installed(root)
    front = Request("front", "/dev/ttyACM1")
    plan = planned(running(root), front)
    assert shown(plan) == [
        "create /etc/systemd/system/multi-user.target.wants/failstop@front.service",
        "create /etc/failstop/front.toml",
        "run systemctl daemon-reload",
        "check that the user failstop can run it",
        "start failstop@front.service",
    ]
    assert plan.restarts == (), "the first robot's service runs on"
    with pytest.raises(InstallError, match=r"'front' needs a board of its own: .* --device"):
        planned(running(root), Request("front"))


def test_another_environment_is_called_where_it_is(root: Path) -> None:
    request = dataclasses.replace(LIVE, command="/srv/venv/bin/failstop")
    made = plan.install(TEXTS, request, None, PlayedSystem(root))
    assert not [step for step in made.steps if isinstance(step, Put) and isinstance(step.content, Environment)]
    listed = put(made, MANIFEST)
    assert isinstance(listed, bytes)
    assert Manifest.load(listed).command == request.command
    units = [step for step in made.steps if isinstance(step, Put) and step.subject.endswith(".service")]
    texts = [step.content for step in units if isinstance(step.content, bytes)]
    assert len(texts) == 4
    assert all(b"=/srv/venv/bin/failstop " in text and b"/opt" not in text for text in texts)
    installed(root)
    with pytest.raises(InstallError, match=r"runs /opt/failstop/bin/failstop is here, .*/srv/venv/bin/failstop"):
        plan.install(TEXTS, request, None, PlayedSystem(root))


def test_a_system_that_does_not_run_is_not_told_anything(root: Path) -> None:
    plan = planned(PlayedSystem(root, live=False))
    commands = [step.words for step in plan.steps if isinstance(step, Run)]
    assert [words[:2] for words in commands] == [
        ("systemd-sysusers", f"--root={root}"),
        ("journalctl", f"--root={root}"),
    ]
    assert not [step for step in plan.steps if isinstance(step, Start)]


@pytest.mark.parametrize(
    ("passwd", "group", "made"),
    [
        (PASSWD, GROUP, False),
        ("", GROUP, True),
        (PASSWD, GROUP.replace("20:failstop", "20:"), True),
        (PASSWD, "dialout:x:20:failstop\n", True),
    ],
    ids=["whole", "no user", "not in dialout", "no group"],
)
def test_the_user_is_made_only_where_something_is_missing(root: Path, passwd: str, group: str, made: bool) -> None:
    write(root, "/etc/passwd", passwd)
    write(root, "/etc/group", group)
    assert ("create user and group failstop" in shown(planned(PlayedSystem(root)))) is made


@pytest.mark.parametrize(
    ("path", "link", "said"),
    [
        ("/usr/lib/systemd/system/failstop.service", "", r"Debian package .*apt remove failstop"),
        (PREFIX, "/srv", r"/opt/failstop is a link to /srv"),
        (f"{PREFIX}/something", "", r"/opt/failstop is there, and is not an installation's"),
        (UNIT, "/dev/null", r"a link to /dev/null, .*: systemctl unmask failstop.service"),
        (RULE, "/x", r"90-failstop.rules is a link to /x, .*: remove it"),
        (SETTINGS, "/x", r"failstop.toml is a link to /x"),
        ("/usr/local/bin/failstop", "", r"/usr/local/bin/failstop is a file, and is not an installation's"),
        (f"{WANTS}/failstop.service", "", r"wants/failstop.service is a file"),
    ],
)
def test_what_is_not_ours_is_refused(root: Path, path: str, link: str, said: str) -> None:
    write(root, path, "")
    if link:
        (root / path.lstrip("/")).unlink()
        (root / path.lstrip("/")).symlink_to(link)
    with pytest.raises(InstallError, match=said):
        planned(PlayedSystem(root))


def removed(steps: tuple[Step, ...]) -> set[str]:
    gone = {step.subject for step in steps if isinstance(step, Put) and step.content is None}
    return gone | {step.subject for step in steps if isinstance(step, Discard) and not step.only_empty}


def test_uninstall_takes_away_all_that_install_wrote_but_the_configuration(root: Path) -> None:
    written = {step.subject for step in installed(root).steps if isinstance(step, Put)}
    plan = uninstall(running(root))
    assert removed(plan.steps) == written - {SETTINGS}
    assert shown(plan)[0] == "stop failstop.service"
    assert plan.notes


def test_purge_takes_the_rest_too_and_a_foreign_user_of_that_name_stays(root: Path) -> None:
    installed(root)
    plan = uninstall(running(root), purge=True)
    assert {"/etc/failstop", "/var/lib/failstop", "/run/failstop"} <= removed(plan.steps)
    assert "remove user failstop" in shown(plan)
    write(root, "/etc/passwd", PASSWD.replace("/var/lib/failstop", "/home/failstop"))
    assert "remove user failstop" not in shown(uninstall(running(root), purge=True))


def test_who_still_tries_to_stop_a_board_is_ended_between_the_service_and_its_files(root: Path) -> None:
    """Its start may be the doing of the service's own end, when the board is away; it runs as the user that goes."""
    installed(root)
    steps = [step.words if isinstance(step, Run) else type(step) for step in uninstall(running(root)).steps]
    assert steps[:2] == [("systemctl", "stop", "failstop.service"), ("systemctl", "stop", "failstop-late@*.service")]


def test_purge_after_an_uninstall_removes_what_that_left(root: Path) -> None:
    write(root, "/etc/passwd", PASSWD)
    write(root, "/etc/group", GROUP)
    assert shown(uninstall(PlayedSystem(root), purge=True)) == [
        "remove /etc/failstop",
        "remove /var/lib/failstop",
        "remove user failstop",
    ]


def test_nothing_to_uninstall_is_said(root: Path) -> None:
    for said in ("no installation", "apt remove failstop"):
        with pytest.raises(InstallError, match=said):
            uninstall(PlayedSystem(root))
        with pytest.raises(InstallError, match=said):
            uninstall_instance("failstop", PlayedSystem(root))
        write(root, "/usr/lib/systemd/system/failstop.service", "the package's")


def test_one_instance_goes_and_the_other_stays(root: Path) -> None:
    installed(root)
    alone = PlayedSystem(root).manifest
    installed(root, Request("front", "/dev/ttyACM1"))
    both = running(root, "failstop@front.service")
    link = "/etc/systemd/system/multi-user.target.wants/failstop@front.service"
    plan = uninstall_instance("front", both)
    assert plan.restarts == ("failstop@front.service",)
    assert removed(plan.steps) == {link}
    listed = put(plan, MANIFEST)
    assert isinstance(listed, bytes)
    assert Manifest.load(listed) == alone
    with pytest.raises(InstallError, match="no instance 'left'"):
        uninstall_instance("left", both)
    own = {"/etc/failstop/front.toml", "/var/lib/failstop/front"}
    assert removed(uninstall_instance("front", both, purge=True).steps) == {link, *own}


def test_a_manifest_is_the_same_after_reading_and_a_damaged_one_is_refused(root: Path) -> None:
    installed(root)
    manifest = PlayedSystem(root).manifest
    assert manifest
    assert Manifest.load(manifest.dump()) == manifest
    for data in (b"", b"[]", b"{}", b'{"version": 1}'):
        with pytest.raises(InstallError, match=r"install.json is damaged"):
            Manifest.load(data)


def test_an_absent_board_is_said(root: Path) -> None:
    with pytest.raises(InstallError, match=r"no device /dev/nothing: plug the board in, .*--device .* --no-start"):
        plan.refuse_absent(dataclasses.replace(LIVE, device="/dev/nothing"), PlayedSystem(root))
    write(root, SETTINGS, 'device.path = "/dev/none"\n')
    with pytest.raises(InstallError, match="no device /dev/none"):
        plan.refuse_absent(LIVE, PlayedSystem(root))
    plan.refuse_absent(dataclasses.replace(LIVE, start=False), PlayedSystem(root))
    plan.refuse_absent(LIVE, PlayedSystem(root, live=False))
    plan.refuse_absent(LIVE, running(root))
    named = PlayedSystem(bare(root / "other"))
    named.board = True
    plan.refuse_absent(LIVE, named)


def test_a_file_that_was_changed_by_hand_is_named_before_it_is_replaced(root: Path) -> None:
    installed(root)
    assert remarks(planned(PlayedSystem(root), texts=TEXTS | {"failstop.udev": "# newer"}))[RULE] == (
        "the board's port: a name, its rights, nobody else touches it"
    )
    write(root, RULE, "mine")
    assert remarks(planned(PlayedSystem(root)))[RULE].endswith("; it was changed by hand")


def test_without_a_start_nothing_is_started_and_what_ran_stays_stopped(root: Path) -> None:
    installed(root)
    plan = planned(running(root), dataclasses.replace(LIVE, start=False), version="2.0")
    assert shown(plan)[0] == "stop failstop.service"
    assert not [step for step in plan.steps if isinstance(step, Start)]


def test_the_list_of_what_is_installed_is_there_before_anything_else_is(root: Path) -> None:
    steps = planned(PlayedSystem(root)).steps
    first = next(step for step in steps if isinstance(step, Put))
    assert isinstance(first.content, Environment)
    [data] = [entry.content for entry in first.content.entries if entry.path == "install.json"]
    assert isinstance(data, bytes)
    listed = Manifest.load(data)
    put = {step.subject for step in steps if isinstance(step, Put)}
    assert {PREFIX, SETTINGS, *listed.files, *listed.links} == put


@pytest.mark.parametrize(
    ("board", "device", "configured"),
    [(False, "", "/dev/ttyACM0"), (True, "", "/dev/failstop"), (True, "/dev/ttyUSB3", "/dev/ttyUSB3")],
)
def test_the_board_s_name_by_the_rule_is_what_a_new_configuration_says(
    root: Path, board: bool, device: str, configured: str
) -> None:
    """A number may be another's after a replug. Where no such board is plugged in, nobody knows that it is one."""
    system = PlayedSystem(root)
    system.board = board
    written = put(planned(system, dataclasses.replace(LIVE, device=device)), SETTINGS)
    assert isinstance(written, bytes)
    assert f'path = "{configured}"'.encode() in written
