"""The bridge to ROS 2 as a service: its user, its unit, and what an installation does for it."""

from __future__ import annotations

import dataclasses

import pytest

from failstop.install import InstallError, rows
from failstop.install.found import Found, Request
from failstop.install.plan import install, uninstall
from failstop.install.rows import BRIDGE
from failstop.install.steps import Command, File
from tests.install.scene import BARE, GROUP, LIVE, PASSWD, TEXTS, after, shown

PLACE = BRIDGE.place
REQUEST = Request(ros2_user="anna")
OWN = rows.texts()
BROUGHT = TEXTS | {name: OWN[name] for name in (BRIDGE.source, rows.FLEET_SETTINGS)}
ANNA = PASSWD + b"anna:x:1000:1000::/home/anna:/bin/bash\n"
MACHINE = dataclasses.replace(
    BARE, files={"/etc/passwd": ANNA, "/etc/group": GROUP}, ros_setup="/opt/ros/jazzy/setup.sh"
)


def installed(request: Request = REQUEST) -> Found:
    """What is there after it; the machine's own account files stay the test's."""
    found = after(install(BROUGHT, request, "tree 1", MACHINE), MACHINE)
    return dataclasses.replace(found, files={**found.files, "/etc/passwd": ANNA})


def test_the_unit_is_written_for_that_user_and_that_ros() -> None:
    plan = install(BROUGHT, REQUEST, "tree 1", MACHINE)
    unit = next(step.data.decode() for step in plan.steps if isinstance(step, File) and step.subject == PLACE)
    assert "User=anna\n" in unit
    assert "/opt/ros/jazzy/setup.sh /opt/failstop/bin/failstop ros2\n" in unit
    member = next(step for step in plan.steps if isinstance(step, Command) and "usermod" in step.words)
    assert member.words == ("usermod", "--append", "--groups", "failstop", "anna")
    assert shown(plan)[-2:] == ["start failstop.service", "start failstop-ros2.service"]
    assert "create /etc/systemd/system/multi-user.target.wants/failstop-ros2.service" in shown(plan)


def test_without_the_option_there_is_none_and_one_that_is_there_stays() -> None:
    assert PLACE not in after(install(BROUGHT, LIVE, "tree 1", MACHINE), MACHINE).files
    found = installed()
    assert install(BROUGHT, LIVE, "tree 1", found).steps == ()
    newer = BROUGHT | {BRIDGE.source: BROUGHT[BRIDGE.source] + "# newer\n"}
    plan = install(newer, LIVE, "tree 1", found)
    assert f"replace {PLACE}" in shown(plan)
    assert b"User=anna\n" in after(plan, found).files[PLACE]


def test_who_is_a_member_already_is_not_made_one() -> None:
    member = dataclasses.replace(MACHINE, files={**MACHINE.files, "/etc/group": GROUP.replace(b"990:", b"990:anna")})
    plan = install(BROUGHT, REQUEST, "tree 1", member)
    assert not [step for step in plan.steps if isinstance(step, Command) and "usermod" in step.words]


def test_uninstall_takes_it_away() -> None:
    plan = uninstall(LIVE, installed())
    assert "stop failstop-ros2.service" in shown(plan)
    assert f"remove {PLACE}" in shown(plan)
    assert "remove /etc/systemd/system/multi-user.target.wants/failstop-ros2.service" in shown(plan)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (Request(ros2_user="nobody-here"), "--ros2-user nobody-here: no such user"),
        (Request(ros2_user="failstop"), "the service's own user"),
        (Request("front", "/dev/ttyACM1", ros2_user="anna"), "for the robot 'failstop' alone"),
    ],
)
def test_who_can_not_be_its_user(asked: Request, said: str) -> None:
    with pytest.raises(InstallError, match=said):
        install(BROUGHT, asked, "tree 1", MACHINE)
