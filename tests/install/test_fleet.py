"""The robot in its fleet as a service: what an installation does for it."""

from __future__ import annotations

import dataclasses

import pytest

from failstop.fleet import settings
from failstop.fleet.settings import KEY_PLACE
from failstop.fleet.settings import PLACE as SETTINGS
from failstop.install import InstallError, rows
from failstop.install.found import Found, Request
from failstop.install.plan import install, uninstall
from failstop.install.rows import FLEET
from failstop.install.steps import File
from tests.install.scene import BARE, LIVE, TEXTS, after, shown

PLACE, UNIT = FLEET.place, FLEET.source
REQUEST = Request(fleet=True)
OWN = rows.texts()
BROUGHT = TEXTS | {name: OWN[name] for name in (FLEET.source, rows.FLEET_SETTINGS)}
MACHINE = dataclasses.replace(BARE, fleet_key=True)


def installed() -> Found:
    """What is there after it."""
    found = after(install(BROUGHT, REQUEST, "tree 1", MACHINE), MACHINE)
    return dataclasses.replace(found, fleet_key=True)


def test_the_unit_its_link_and_an_example_of_its_settings() -> None:
    plan = install(BROUGHT, REQUEST, "tree 1", MACHINE)
    written = {step.subject: step.data.decode() for step in plan.steps if isinstance(step, File)}
    assert f"ExecStart=/opt/failstop/bin/failstop fleet publish --config {SETTINGS}\n" in written[PLACE]
    assert f"LoadCredential=fleet.key:{KEY_PLACE}\n" in written[PLACE]
    assert written[SETTINGS] == settings.example()
    assert shown(plan)[-2:] == ["start failstop.service", f"start {UNIT}"]
    assert f"create /etc/systemd/system/multi-user.target.wants/{UNIT}" in shown(plan)


def test_without_the_option_there_is_none_and_one_that_is_there_stays() -> None:
    assert PLACE not in after(install(BROUGHT, LIVE, "tree 1", MACHINE), MACHINE).files
    found = installed()
    assert install(BROUGHT, LIVE, "tree 1", found).steps == ()
    newer = BROUGHT | {FLEET.source: BROUGHT[FLEET.source] + "# newer\n"}
    assert f"replace {PLACE}" in shown(install(newer, LIVE, "tree 1", found))


def test_settings_that_are_there_are_the_users() -> None:
    own = dataclasses.replace(MACHINE, files={**MACHINE.files, SETTINGS: b"broker.host = 'hall'\n"})
    plan = install(BROUGHT, REQUEST, "tree 1", own)
    assert SETTINGS not in {step.subject for step in plan.steps if isinstance(step, File)}


def test_uninstall_takes_the_unit_away_and_leaves_settings_and_key() -> None:
    plan = uninstall(LIVE, installed())
    assert f"stop {UNIT}" in shown(plan)
    assert f"remove {PLACE}" in shown(plan)
    assert not [line for line in shown(plan) if SETTINGS in line or KEY_PLACE in line]


@pytest.mark.parametrize(
    ("request_", "found", "words"),
    [
        (REQUEST, BARE, "`failstop fleet key`"),
        (Request("front", "/dev/ttyACM1", fleet=True), MACHINE, "for the robot 'failstop' alone"),
        (REQUEST, dataclasses.replace(MACHINE, links={PLACE: "/somewhere"}), "is a link to /somewhere"),
    ],
)
def test_refusals(request_: Request, found: Found, words: str) -> None:
    with pytest.raises(InstallError, match=words):
        install(BROUGHT, request_, "tree 1", found)
