"""The operator's page as a service: its unit, and what an installation does for it."""

from __future__ import annotations

import dataclasses

import pytest

from failstop.install import InstallError, rows
from failstop.install.found import Found, Request
from failstop.install.plan import install, uninstall
from failstop.install.rows import MAY_DRIVE, OPERATE, PAGE, PAGE_USER, VIEW
from tests.install.scene import BARE, GROUP, LIVE, PASSWD, TEXTS, after, shown

PLACE = PAGE.place
OWN = rows.texts()
BROUGHT = TEXTS | {name: OWN[name] for name in (PAGE.source, rows.FLEET_SETTINGS)}
ACCOUNTS = {"/etc/passwd": PASSWD, "/etc/group": GROUP}
MACHINE = dataclasses.replace(BARE, files=ACCOUNTS)


def installed(which: str) -> Found:
    """What is there after it; the machine's own account files stay the test's."""
    found = after(install(BROUGHT, Request(web=which), "tree 1", MACHINE), MACHINE)
    return dataclasses.replace(found, files={**found.files, **ACCOUNTS})


def test_it_is_put_in_place_and_started() -> None:
    plan = install(BROUGHT, Request(web=VIEW), "tree 1", MACHINE)
    assert shown(plan)[-2:] == ["start failstop.service", "start failstop-web.service"]
    assert "create /etc/systemd/system/multi-user.target.wants/failstop-web.service" in shown(plan)
    unit = installed(VIEW).files[PLACE].decode()
    assert "ExecStart=/opt/failstop/bin/failstop web --config /etc/failstop/failstop.toml\n" in unit
    assert MAY_DRIVE not in unit, "who only sees and stops may not drive"


def test_paired_devices_need_the_group() -> None:
    assert PAGE_USER + MAY_DRIVE in installed(OPERATE).files[PLACE].decode()


def test_without_the_option_there_is_none_and_one_that_is_there_stays_what_it_is() -> None:
    assert PLACE not in after(install(BROUGHT, LIVE, "tree 1", MACHINE), MACHINE).files
    for which in (VIEW, OPERATE):
        found = installed(which)
        assert install(BROUGHT, LIVE, "tree 1", found).steps == ()
        newer = BROUGHT | {PAGE.source: BROUGHT[PAGE.source] + "# newer\n"}
        plan = install(newer, LIVE, "tree 1", found)
        assert f"replace {PLACE}" in shown(plan)
        assert (MAY_DRIVE.encode() in after(plan, found).files[PLACE]) == (which == OPERATE)


def test_uninstall_takes_it_away() -> None:
    plan = uninstall(LIVE, installed(VIEW))
    assert "stop failstop-web.service" in shown(plan)
    assert f"remove {PLACE}" in shown(plan)


def test_it_is_for_the_one_robot() -> None:
    with pytest.raises(InstallError, match="for the robot 'failstop' alone"):
        install(BROUGHT, Request("left", "/dev/ttyACM1", web=VIEW), "tree 1", MACHINE)


def test_a_unit_of_somebody_else_stays() -> None:
    linked = dataclasses.replace(MACHINE, links={PLACE: "/dev/null"})
    with pytest.raises(InstallError, match="is a link to"):
        install(BROUGHT, Request(web=VIEW), "tree 1", linked)
