"""What an installation would do, and what taking it away would: pure."""

from __future__ import annotations

import dataclasses

import pytest

from failstop.install import InstallError
from failstop.install.found import Found, Request
from failstop.install.layout import MANIFEST, PREFIX, Manifest
from failstop.install.plan import install, uninstall, uninstall_instance
from failstop.install.steps import Command, Directory, File, Link, Plan, Remove, Start, Step, Tree
from tests.install.scene import BARE, EXAMPLE, GROUP, LIVE, PASSWD, TEXTS, after, shown


def installed(tree: str = "tree 1") -> Found:
    return after(install(TEXTS, LIVE, tree, BARE), BARE, tree)


def at(plan: Plan, wanted: str) -> int:
    return next(index for index, line in enumerate(shown(plan)) if wanted in line)


def test_a_bare_machine_gets_everything_in_an_order_that_works() -> None:
    plan = install(TEXTS, LIVE, "tree 1", BARE)
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
        "create /etc/failstop/failstop.toml",
        "create user and group failstop",
        "create /usr/local/bin/failstop",
        "create /etc/systemd/system/multi-user.target.wants/failstop.service",
        "create /etc/systemd/system/some.device.wants/failstop.service",
        "create /etc/systemd/system/sleep.target.wants/failstop-sleep.service",
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


def test_what_is_shown_of_the_steps() -> None:
    remarks = {step.subject: step.remark for step in install(TEXTS, LIVE, "tree 1", BARE).steps}
    wants = "/etc/systemd/system/multi-user.target.wants/failstop.service"
    sleep = "/etc/systemd/system/sleep.target.wants/failstop-sleep.service"
    assert [remarks[path] for path in ("/usr/local/bin/failstop", wants, sleep)] == [
        "the command",
        "starts at boot",
        "before a sleep",
    ]
    assert remarks["user and group failstop"] == "the service runs as it; in the groups of dialout"
    gone = {step.subject: step.remark for step in uninstall(LIVE, installed()).steps}
    assert gone[PREFIX] == "the Python environment"


def test_every_directory_that_is_missing_is_made_before_it_is_used() -> None:
    there = {"/", *BARE.directories}
    for step in install(TEXTS, LIVE, "tree 1", BARE).steps:
        if isinstance(step, (Directory, File, Link, Tree)):
            assert step.subject.rpartition("/")[0] in there, step
        if isinstance(step, (Directory, Tree)):
            there.add(step.subject)


def test_the_second_time_there_is_nothing_to_do() -> None:
    assert install(TEXTS, LIVE, "tree 1", installed()).steps == ()


def test_an_installed_service_that_does_not_run_is_started() -> None:
    found = dataclasses.replace(installed(), active=())
    assert shown(install(TEXTS, LIVE, "tree 1", found)) == ["start failstop.service"]
    assert install(TEXTS, dataclasses.replace(LIVE, start=False), "tree 1", found).steps == ()


def test_another_version_is_replaced_with_the_service_stopped_first_and_started_last() -> None:
    newer = {**TEXTS, "failstop.service": "[Install]\n"}
    plan = install(newer, LIVE, "tree 2", installed())
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
    assert isinstance(stop, Command)
    assert stop.undo == ("systemctl", "start", "--no-block", "failstop.service")
    assert "configuration" not in " ".join(shown(plan))
    assert install(newer, LIVE, "tree 2", after(plan, installed(), "tree 2")).steps == ()


def test_what_no_service_reads_is_replaced_without_a_restart() -> None:
    plan = install(TEXTS | {"failstop.udev": "# other\n"}, LIVE, "tree 1", installed())
    assert plan.restarts == ()
    assert "start failstop.service" not in shown(plan)
    assert "replace /etc/udev/rules.d/90-failstop.rules" in shown(plan)


def test_a_file_that_only_an_older_version_had_is_removed() -> None:
    found = installed()
    assert found.manifest
    manifest = dataclasses.replace(found.manifest, files={**found.manifest.files, "/etc/udev/rules.d/1-old": "0"})
    kept = dataclasses.replace(found, manifest=manifest, files={**found.files, MANIFEST: manifest.dump()})
    plan = install(TEXTS, LIVE, "tree 1", kept)
    assert "remove /etc/udev/rules.d/1-old" in shown(plan)


def test_a_damaged_environment_or_unit_is_repaired() -> None:
    found = installed()
    assert "replace /opt/failstop" in shown(install(TEXTS, LIVE, "tree 1", dataclasses.replace(found, tree="rot")))
    unit = "/etc/systemd/system/failstop.service"
    damaged = dataclasses.replace(found, files={**found.files, unit: b""})
    assert f"replace {unit}" in shown(install(TEXTS, LIVE, "tree 1", damaged))


def test_a_configuration_that_is_there_stays() -> None:
    path = "/etc/failstop/failstop.toml"
    found = dataclasses.replace(BARE, files={**BARE.files, path: b"mine"}, configured_device="/dev/mine")
    plan = install(TEXTS, LIVE, "tree 1", found)
    assert not [step for step in plan.steps if isinstance(step, File) and step.subject == path]
    assert plan.notes == (f"{path} is yours and stays as it is",)
    with pytest.raises(InstallError, match=r"failstop.toml says device.path = '/dev/mine': change it there"):
        install(TEXTS, dataclasses.replace(LIVE, device="/dev/other"), "tree 1", found)
    assert install(TEXTS, dataclasses.replace(LIVE, device="/dev/mine"), "tree 1", found).steps


def test_the_device_is_written_into_a_new_configuration_and_nothing_else_is_changed() -> None:
    plan = install(TEXTS, dataclasses.replace(LIVE, device="/dev/board"), "tree 1", BARE)
    (step,) = [step for step in plan.steps if isinstance(step, File) and step.subject.endswith(".toml")]
    assert step.data.decode() == EXAMPLE.replace("/dev/ttyACM0", "/dev/board")


def test_a_second_robot_is_an_instance_with_a_board_of_its_own() -> None:
    front = Request("front", "/dev/ttyACM1")
    found = dataclasses.replace(installed(), configured_device="")
    plan = install(TEXTS, front, "tree 1", found)
    assert shown(plan) == [
        "create /etc/failstop/front.toml",
        "create /etc/systemd/system/multi-user.target.wants/failstop@front.service",
        "run systemctl daemon-reload",
        "check that the user failstop can run it",
        "start failstop@front.service",
    ]
    assert plan.restarts == (), "the first robot's service runs on"
    with pytest.raises(InstallError, match=r"'front' needs a board of its own: .* --device"):
        install(TEXTS, Request("front"), "tree 1", found)


def test_another_environment_is_called_where_it_is() -> None:
    plan = install(TEXTS, dataclasses.replace(LIVE, command="/srv/venv/bin/failstop"), "", BARE)
    assert not [step for step in plan.steps if isinstance(step, Tree)]
    assert Directory("", PREFIX) in plan.steps, "for the list alone"
    assert Directory("", PREFIX) not in install(TEXTS, LIVE, "tree 1", BARE).steps, "it is the tree itself"
    units = [step for step in plan.steps if isinstance(step, File) and step.subject.endswith(".service")]
    assert len(units) == 4
    assert all(b"=/srv/venv/bin/failstop " in step.data and b"/opt" not in step.data for step in units)
    with pytest.raises(InstallError, match=r"runs /opt/failstop/bin/failstop is here, .*/srv/venv/bin/failstop"):
        install(TEXTS, dataclasses.replace(LIVE, command="/srv/venv/bin/failstop"), "", installed())


def test_a_system_that_does_not_run_is_not_told_anything() -> None:
    plan = install(TEXTS, Request(root="/mnt/image", live=False), "tree 1", BARE)
    commands = [step.words for step in plan.steps if isinstance(step, Command)]
    assert [words[:2] for words in commands] == [
        ("systemd-sysusers", "--root=/mnt/image"),
        ("journalctl", "--root=/mnt/image"),
    ]
    assert not [step for step in plan.steps if isinstance(step, Start)]


def test_the_user_is_made_only_where_something_is_missing() -> None:
    def made(passwd: bytes, group: bytes) -> bool:
        found = dataclasses.replace(BARE, files={"/etc/passwd": passwd, "/etc/group": group})
        return "create user and group failstop" in shown(install(TEXTS, LIVE, "tree 1", found))

    assert not made(PASSWD, GROUP)
    assert made(b"", GROUP)
    assert made(PASSWD, GROUP.replace(b"20:failstop", b"20:")), "not in dialout"
    assert made(PASSWD, b"dialout:x:20:failstop\n"), "no group"


@pytest.mark.parametrize(
    ("found", "said"),
    [
        ({"package": True}, r"Debian package .*apt remove failstop"),
        ({"links": {PREFIX: "/srv"}}, r"/opt/failstop is a link to /srv"),
        ({"tree": "something"}, r"/opt/failstop is there, and is not an installation's"),
        (
            {"links": {"/etc/systemd/system/failstop.service": "/dev/null"}},
            r"masked: systemctl unmask failstop.service",
        ),
        ({"links": {"/etc/udev/rules.d/90-failstop.rules": "/x"}}, r"90-failstop.rules is a link to /x"),
        ({"files": {"/usr/local/bin/failstop": b""}}, r"/usr/local/bin/failstop is a file"),
    ],
)
def test_what_is_not_ours_is_refused(found: dict[str, object], said: str) -> None:
    with pytest.raises(InstallError, match=said):
        install(TEXTS, LIVE, "tree 1", dataclasses.replace(BARE, **found))  # type: ignore[arg-type]


def removed(steps: tuple[Step, ...]) -> set[str]:
    return {step.subject for step in steps if isinstance(step, Remove) and not step.only_empty}


def test_uninstall_takes_away_all_that_install_wrote_but_the_configuration() -> None:
    written = {
        step.subject
        for step in install(TEXTS, LIVE, "tree 1", BARE).steps
        if isinstance(step, (File, Link, Tree)) and step.subject != MANIFEST
    }
    plan = uninstall(LIVE, installed())
    assert removed(plan.steps) == written - {"/etc/failstop/failstop.toml"}
    assert shown(plan)[0] == "stop failstop.service"
    assert at(plan, "remove /opt/failstop") < at(plan, "daemon-reload")
    assert plan.notes


def test_purge_takes_the_rest_too_and_a_foreign_user_of_that_name_stays() -> None:
    plan = uninstall(LIVE, installed(), purge=True)
    assert {"/etc/failstop", "/var/lib/failstop", "/run/failstop"} <= removed(plan.steps)
    assert "remove user failstop" in shown(plan)
    found = installed()
    person = PASSWD.replace(b"/var/lib/failstop", b"/home/failstop")
    foreign = dataclasses.replace(found, files={**found.files, "/etc/passwd": person})
    assert "remove user failstop" not in shown(uninstall(LIVE, foreign, purge=True))


def test_who_still_tries_to_stop_a_board_is_ended_between_the_service_and_its_files() -> None:
    """Its start may be the doing of the service's own end, when the board is away; it runs as the user that goes."""
    plan = uninstall(LIVE, dataclasses.replace(installed(), active=("failstop.service",)))
    steps = [step.words if isinstance(step, Command) else type(step) for step in plan.steps]
    assert steps[:2] == [("systemctl", "stop", "failstop.service"), ("systemctl", "stop", "failstop-late@*.service")]


def test_purge_after_an_uninstall_removes_what_that_left() -> None:
    left = dataclasses.replace(BARE, files={"/etc/passwd": PASSWD, "/etc/group": GROUP})
    assert shown(uninstall(LIVE, left, purge=True)) == [
        "remove /etc/failstop",
        "remove /var/lib/failstop",
        "remove user failstop",
    ]


@pytest.mark.parametrize(("found", "said"), [(BARE, "no installation"), (Found(package=True), "apt remove failstop")])
def test_nothing_to_uninstall_is_said(found: Found, said: str) -> None:
    for take in (uninstall, uninstall_instance):
        with pytest.raises(InstallError, match=said):
            take(LIVE, found)


def test_one_instance_goes_and_the_other_stays() -> None:
    front = Request("front", "/dev/ttyACM1")
    one = dataclasses.replace(installed(), configured_device="")
    both = after(install(TEXTS, front, "tree 1", one), one)
    plan = uninstall_instance(front, both)
    assert plan.restarts == ("failstop@front.service",)
    assert removed(plan.steps) == {"/etc/systemd/system/multi-user.target.wants/failstop@front.service"}
    left = after(plan, both)
    assert left.manifest == installed().manifest
    with pytest.raises(InstallError, match="no instance 'front'"):
        uninstall_instance(front, left)
    assert removed(uninstall_instance(front, both, purge=True).steps) > removed(plan.steps)


def test_a_manifest_is_the_same_after_reading_and_a_damaged_one_is_refused() -> None:
    manifest = installed().manifest
    assert manifest
    assert Manifest.load(manifest.dump()) == manifest
    for data in (b"", b"[]", b"{}", b'{"version": 1}'):
        with pytest.raises(InstallError, match=r"install.json is damaged"):
            Manifest.load(data)


def test_an_absent_board_is_said_before_anything_is_done() -> None:
    absent = dataclasses.replace(BARE, device_there=False)
    with pytest.raises(InstallError, match=r"no device /dev/ttyACM0: plug the board in, .*--device .* --no-start"):
        install(TEXTS, LIVE, "tree 1", absent)
    with pytest.raises(InstallError, match="no device /dev/board"):
        install(TEXTS, dataclasses.replace(LIVE, device="/dev/board"), "tree 1", absent)
    for request in (dataclasses.replace(LIVE, start=False), dataclasses.replace(LIVE, live=False, root="/mnt")):
        assert install(TEXTS, request, "tree 1", absent).steps
    running = dataclasses.replace(installed(), device_there=False)
    assert install(TEXTS, LIVE, "tree 1", running).steps == (), "it runs: it waits for the board itself"


def test_a_file_that_was_changed_by_hand_is_named_before_it_is_replaced() -> None:
    found = installed()
    path = "/etc/udev/rules.d/90-failstop.rules"
    edited = dataclasses.replace(found, files={**found.files, path: b"mine"})
    remarks = {step.subject: step.remark for step in install(TEXTS, LIVE, "tree 1", edited).steps}
    assert remarks[path].endswith("; it was changed by hand")
    newer = TEXTS | {"failstop.udev": "# newer"}
    remarks = {step.subject: step.remark for step in install(newer, LIVE, "tree 1", found).steps}
    assert "by hand" not in remarks[path]


def test_without_a_start_nothing_is_started_and_what_ran_stays_stopped() -> None:
    request = dataclasses.replace(LIVE, start=False)
    plan = install(TEXTS, request, "tree 2", installed())
    assert shown(plan)[0] == "stop failstop.service"
    assert not [step for step in plan.steps if isinstance(step, Start)]


def test_the_list_of_what_is_installed_is_there_before_anything_else_is() -> None:
    steps = install(TEXTS, LIVE, "tree 1", BARE).steps
    first = next(step for step in steps if isinstance(step, (File, Link, Tree)))
    assert isinstance(first, Tree)
    listed = Manifest.load(first.manifest)
    assert {*listed.files, *listed.links} == {
        step.subject for step in steps if isinstance(step, (File, Link)) and "/failstop.toml" not in step.subject
    }


@pytest.mark.parametrize(
    ("board", "device", "configured"),
    [(False, "", "/dev/ttyACM0"), (True, "", "/dev/failstop"), (True, "/dev/ttyUSB3", "/dev/ttyUSB3")],
)
def test_the_board_s_name_by_the_rule_is_what_a_new_configuration_says(
    board: bool, device: str, configured: str
) -> None:
    """A number may be another's after a replug. Where no such board is plugged in, nobody knows that it is one."""
    plan = install(TEXTS, dataclasses.replace(LIVE, device=device), "tree 1", dataclasses.replace(BARE, board=board))
    [written] = [step.data for step in plan.steps if isinstance(step, File) and step.subject.endswith(".toml")]
    assert f'path = "{configured}"'.encode() in written
