"""The extras as services: the bridge to ROS 2, the robot in its fleet, the operator's page."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.fleet import settings
from failstop.fleet.settings import KEY_PLACE
from failstop.fleet.settings import PLACE as FLEET_PLACE
from failstop.install import InstallError, rows
from failstop.install.plan import Request, uninstall
from failstop.install.rows import BRIDGE, EXTRAS, FLEET, MAY_DRIVE, OPERATE, PAGE, PAGE_USER, VIEW, YES, Extra
from tests.install.scene import GROUP, LIVE, PASSWD, TEXTS, PlayedSystem, bare, installed, planned, running, shown

OWN = rows.texts()
BROUGHT = TEXTS | {name: OWN[name] for name in (*(extra.source for extra in EXTRAS), rows.FLEET_SETTINGS)}
ANNA = PASSWD + "anna:x:1000:1000::/home/anna:/bin/bash\n"
ASKED = [(BRIDGE, "anna"), (FLEET, YES), (PAGE, VIEW), (PAGE, OPERATE)]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A system with the user of ROS nodes, two versions of ROS, and the fleet's key."""
    root = bare(tmp_path)
    (root / "etc/passwd").write_text(ANNA)
    (root / "etc/group").write_text(GROUP)
    for path in ("opt/ros/humble/setup.sh", "opt/ros/jazzy/setup.sh", KEY_PLACE.lstrip("/")):
        (root / path).parent.mkdir(parents=True)
        (root / path).touch()
    return root


def asking(extra: Extra, word: str) -> Request:
    return Request(extras={extra.option: word})


def unit(root: Path, extra: Extra) -> str:
    return (root / extra.place.lstrip("/")).read_text()


@pytest.mark.parametrize(("extra", "word"), ASKED)
def test_it_is_put_in_place_and_started_after_the_service(root: Path, extra: Extra, word: str) -> None:
    plan = installed(root, asking(extra, word), BROUGHT)
    assert shown(plan)[-2:] == ["start failstop.service", f"start {extra.source}"]
    assert f"create /etc/systemd/system/multi-user.target.wants/{extra.source}" in shown(plan)
    assert "ExecStart=" in unit(root, extra)


@pytest.mark.parametrize(("extra", "word"), ASKED)
def test_without_the_option_there_is_none_and_one_that_is_there_stays_what_it_is(
    root: Path, extra: Extra, word: str
) -> None:
    installed(root, LIVE, BROUGHT)
    assert not (root / extra.place.lstrip("/")).exists()
    installed(root, asking(extra, word), BROUGHT)
    before = unit(root, extra)
    assert planned(running(root, extra.source), LIVE, BROUGHT).steps == ()
    newer = BROUGHT | {extra.source: BROUGHT[extra.source] + "# newer\n"}
    assert f"replace {extra.place}" in shown(installed(root, LIVE, newer))
    assert unit(root, extra) == before + "# newer\n"


@pytest.mark.parametrize(("extra", "word"), ASKED)
def test_uninstall_takes_it_away_and_leaves_settings_and_key(root: Path, extra: Extra, word: str) -> None:
    installed(root, asking(extra, word), BROUGHT)
    lines = shown(uninstall(running(root, extra.source)))
    assert {f"stop {extra.source}", f"remove {extra.place}"} <= {*lines}
    assert f"remove /etc/systemd/system/multi-user.target.wants/{extra.source}" in lines
    assert not [line for line in lines if FLEET_PLACE in line or KEY_PLACE in line]


def test_the_bridge_is_that_user_s_and_sources_the_newest_ros(root: Path) -> None:
    installed(root, asking(BRIDGE, "anna"), BROUGHT)
    assert "User=anna\n" in unit(root, BRIDGE)
    assert "/opt/ros/jazzy/setup.sh /opt/failstop/bin/failstop ros2\n" in unit(root, BRIDGE)
    assert "SupplementaryGroups=failstop\n" in unit(root, BRIDGE), "it may drive"


def test_the_fleet_has_its_key_and_an_example_of_settings_that_are_the_users(root: Path) -> None:
    installed(root, asking(FLEET, YES), BROUGHT)
    assert f"ExecStart=/opt/failstop/bin/failstop fleet publish --config {FLEET_PLACE}\n" in unit(root, FLEET)
    assert f"LoadCredential=fleet.key:{KEY_PLACE}\n" in unit(root, FLEET)
    own = root / FLEET_PLACE.lstrip("/")
    assert own.read_text() == settings.example()
    own.write_text("broker.host = 'hall'\n")
    assert planned(running(root, FLEET.source), asking(FLEET, YES), BROUGHT).steps == ()


def test_the_page_may_drive_where_its_devices_may_operate(root: Path) -> None:
    installed(root, asking(PAGE, VIEW), BROUGHT)
    assert "ExecStart=/opt/failstop/bin/failstop web --config /etc/failstop/failstop.toml\n" in unit(root, PAGE)
    assert MAY_DRIVE not in unit(root, PAGE), "who only sees and stops may not drive"
    installed(root, asking(PAGE, OPERATE), BROUGHT)
    assert PAGE_USER + MAY_DRIVE in unit(root, PAGE)


@pytest.mark.parametrize(("extra", "word"), ASKED)
def test_it_is_for_the_one_robot_and_not_over_a_unit_of_somebody_else(root: Path, extra: Extra, word: str) -> None:
    with pytest.raises(InstallError, match=f"{extra.option}: .*for the robot 'failstop' alone"):
        planned(PlayedSystem(root), Request("front", "/dev/ttyACM1", extras={extra.option: word}), BROUGHT)
    (root / extra.place.lstrip("/")).symlink_to("/somewhere")
    with pytest.raises(InstallError, match="is a link to /somewhere"):
        planned(PlayedSystem(root), asking(extra, word), BROUGHT)


@pytest.mark.parametrize(
    ("extra", "word", "said"),
    [
        (BRIDGE, "nobody-here", "--ros2-user nobody-here: no such user"),
        (BRIDGE, "failstop", "the service's own user"),
        (FLEET, YES, "`failstop fleet key`"),
    ],
)
def test_what_can_not_be(root: Path, extra: Extra, word: str, said: str) -> None:
    (root / KEY_PLACE.lstrip("/")).unlink()
    with pytest.raises(InstallError, match=said):
        planned(PlayedSystem(root), asking(extra, word), BROUGHT)
