"""The files of the system as systemd's own tools judge them, and against each other and the code."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from failstop.api import ask
from failstop.board.asking import ADAPTERS
from failstop.board.kinds import board_of
from failstop.board.rrc.board import BOARD
from failstop.cli.commands import stop
from failstop.files.root import SYSTEM_BASE
from failstop.policy.layouts import BOARDS
from failstop.policy.processes import PROCESSES
from failstop.policy.settings import BY_KEY, Settings
from failstop.procs.peer import LEAVE_AFTER_NS
from failstop.setup import ports
from failstop.supervisor import blackbox, main
from failstop.supervisor.run import GROUP
from tests.systemd.units import OLDEST, SINCE, SYSTEMD, analyze, needs_analyze, settings

ONE, MANY = "failstop.service", "failstop@.service"
BRIDGE = "failstop-ros2@.service"
FLEET = "failstop-fleet.service"
SLEEP = "failstop-sleep.service"
LATE, LATE_MANY = "failstop-late.service", "failstop-late@.service"
WEB = "failstop-web.service"
GUARD = "failstop-guard@.service"
EXPOSURES = {
    ONE: 0.9,
    "failstop@a.service": 0.9,
    FLEET: 1.8,
    WEB: 1.9,
    LATE: 3.8,
    "failstop-late@a.service": 3.8,
    SLEEP: 3.9,
    "failstop-ros2@a.service": 5.4,
    "failstop-guard@a.service": 1.5,
}
"""The exposure of each unit as systemd-analyze has it, 0 to 10: what a change may not exceed."""
JUDGED_BY = 252
"""The systemd that found these; another one judges by other rows, and may find a little more."""


UNIT = dict(settings(ONE))


@pytest.fixture
def runnable(tmp_path: Path) -> Path:
    """The units with a command that is there: an absent one is all that would be found."""
    for name in (ONE, MANY, SLEEP, LATE, LATE_MANY, BRIDGE, FLEET, WEB, GUARD):
        text = (SYSTEMD / name).read_text()
        (tmp_path / name).write_text(text.replace("/opt/failstop/bin/failstop", "/bin/true"))
    return tmp_path


@needs_analyze
@pytest.mark.parametrize(
    "name",
    [
        ONE,
        "failstop@a.service",
        SLEEP,
        LATE,
        "failstop-late@a.service",
        "failstop-ros2@root.service",
        "failstop-guard@root.service",
        FLEET,
    ],
)
def test_verify_finds_nothing(runnable: Path, name: str) -> None:
    """The tool's exit code is 0 for unknown keys and bad values too."""
    if "@" in name:
        (runnable / name).symlink_to(re.sub("@.*[.]", "@.", name))
    done = analyze("verify", "--man=no", str(runnable / name))
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@needs_analyze
def test_verify_would_find_something(runnable: Path) -> None:
    path = runnable / ONE
    path.write_text(path.read_text().replace("WatchdogSec=", "WatchdogSecs="))
    assert "WatchdogSecs" in analyze("verify", "--man=no", str(path)).stderr


@needs_analyze
@pytest.mark.parametrize("name", EXPOSURES)
def test_exposure(runnable: Path, name: str) -> None:
    if "@" in name:
        (runnable / name).symlink_to(re.sub("@.*[.]", "@.", name))
    done = analyze("security", "--offline=true", "--no-pager", "--threshold=100", str(runnable / name))
    if "offline" in done.stderr:
        pytest.skip("this systemd-analyze judges no files (--offline)")
    found = re.search(r"exposure level for \S+: ([\d.]+)", done.stdout)
    assert found, done
    by = int(analyze("--version").stdout.split()[1])
    assert float(found[1]) <= EXPOSURES[name] + (by != JUDGED_BY)


@needs_analyze
def test_each_exposure_that_is_left_is_meant(runnable: Path) -> None:
    done = analyze("security", "--offline=true", "--json=short", str(runnable / ONE))
    if done.returncode:
        pytest.skip("this systemd-analyze judges no files (--offline)")
    left = {row["json_field"] for row in json.loads(done.stdout) if row.get("exposure")}
    assert left <= {
        "SystemCallFilter_resources",  # real-time priorities
        "SystemCallFilter_privileged",  # chown: shared memory is given to the group
        "RestrictRealtime",
        "RestrictAddressFamilies_AF_UNIX",  # sd_notify, the journal, descriptors handed over
        "PrivateDevices",  # the port
        "DeviceAllow",
        "RemoveIPC",  # other instances, the black box
        "UMask",  # incidents are for everybody to read
        "PrivateUsers",  # real-time priorities of the machine's own user
        "RootDirectoryOrRootImage",
    }


def test_the_template_differs_in_the_name_alone() -> None:
    one, many = ((SYSTEMD / name).read_text() for name in (ONE, MANY))
    for ours, theirs in (
        ("failstop@.service is this file for several robots", "failstop.service is this file for one robot"),
        ("Description=failstop: stops the robot", "Description=failstop: stops robot %i"),
        ("bin/failstop run --config", "bin/failstop run --name %i --config"),
        ("bin/failstop stop --config", "bin/failstop stop --name %i --config"),
        ("/etc/failstop/failstop.toml", "/etc/failstop/%i.toml"),
        ("failstop-late.service", "failstop-late@%i.service"),
        ("StateDirectory=failstop/failstop\n", "StateDirectory=failstop/%i\n"),
    ):
        assert ours in one
        one = one.replace(ours, theirs)
    assert one[: one.index("[Install]")] == many[: many.index("[Install]")]
    assert many.endswith("[Install]\nWantedBy=multi-user.target\n")


@pytest.mark.parametrize("name", [ONE, BRIDGE, FLEET, GUARD])
def test_nothing_that_systemd_249_does_not_know(name: str) -> None:
    assert [key for key, _ in settings(name) if SINCE.get(key, OLDEST + 1) > OLDEST] == []


def test_the_wheels_stand_before_the_machine_sleeps() -> None:
    """Ordered before the target that every way to sleep waits for, and started by it; a sleep waits for a oneshot."""
    found = dict(settings(SLEEP))
    assert (found["Before"], found["WantedBy"], found["Type"]) == ("sleep.target", "sleep.target", "oneshot")
    assert found["ExecStart"].startswith("/opt/failstop/bin/failstop stop --services ")
    assert float(found["TimeoutStartSec"]) > 2 * ask.LATCH_S


@pytest.mark.parametrize("name", [ONE, MANY])
def test_the_drivers_of_the_device_classes_are_loaded_before(name: str) -> None:
    """The port is otherwise refused to the service, and to its stop tool, until the next start. Serial pins need no
    module."""
    drivers = {"ttyACM": "cdc_acm", "ttyUSB": "usbserial"}
    wanted = " ".join(f"modprobe@{drivers[found]}.service" for found in allowed(name) if found in drivers)
    assert ("Wants", wanted) in settings(name)
    assert ("After", wanted) in settings(name)


def allowed(name: str) -> list[str]:
    """The classes of devices that a unit may open."""
    return [value.split("-")[1].split()[0] for key, value in settings(name) if key == "DeviceAllow"]


@pytest.mark.parametrize("name", [ONE, MANY, LATE, LATE_MANY])
def test_the_service_and_its_stop_may_open_every_port_that_setup_offers(name: str) -> None:
    """USB, and the serial pins of a Raspberry Pi or a Jetson; /dev/serial0 is a link to one of these."""
    offered = [found[1] for node in ports.NODES if (found := re.match("/dev/(tty[A-Z]+)", node))]
    assert len(offered) == len(ports.NODES) - 1
    assert allowed(name) == offered


def test_the_template_that_goes_on_trying_differs_in_the_name_alone() -> None:
    one, many = ((SYSTEMD / name).read_text() for name in (LATE, LATE_MANY))
    for ours, theirs in (
        ("More in docs", "%i is the service's name. More in docs"),
        ("failstop-late@.service is this file for several robots", "failstop-late.service is this file for one robot"),
        ("writes a stop that", "writes a stop of robot %i that"),
        ("Conflicts=failstop.service", "Conflicts=failstop@%i.service"),
        ("stop --config /etc/failstop/failstop.toml", "stop --name %i --config /etc/failstop/%i.toml"),
    ):
        assert ours in one
        one = one.replace(ours, theirs)
    assert one == many


@pytest.mark.parametrize(
    ("name", "late", "service"),
    [(ONE, LATE, ONE), (MANY, "failstop-late@%i.service", "failstop@%i.service")],
)
def test_a_stop_that_was_not_written_is_somebody_elses_until_the_service_runs_again(
    name: str, late: str, service: str
) -> None:
    found, its = settings(name), settings(late.replace("%i", ""))
    for key in ("OnFailure", "Conflicts", "After"):
        assert (key, late) in found, "ordered, so that it has let go of the port before the service opens it"
    assert ("OnFailureJobMode", "fail") in found
    assert ("Conflicts", service) in its, "so that it does not start while a start of the service waits"
    command = dict(its)["ExecStart"]
    assert command.startswith("/opt/failstop/bin/failstop stop --")
    assert "--last-port" in command, "as ExecStopPost, where the dead run really had its board"
    BY_KEY["stop.wait_s"].check(float(command.split()[-1]))


@pytest.mark.parametrize("name", [ONE, MANY])
def test_commands_are_run_without_a_shell_and_stop_before_systemd_loses_patience(name: str) -> None:
    found = settings(name)
    [start], [post] = ([value for key, value in found if key == wanted] for wanted in ("ExecStart", "ExecStopPost"))
    run = "/opt/failstop/bin/failstop run "
    assert start.startswith(run)
    same = start.removeprefix(run)
    assert post == f"/opt/failstop/bin/failstop stop {same} --end-service", "of the same robot"


def test_timeouts_leave_room_for_the_stop_tool() -> None:
    assert float(UNIT["TimeoutStopSec"]) >= stop.END_SERVICE_S + 2
    assert float(UNIT["TimeoutStopSec"]) > main.END_S * len(PROCESSES) + main.HEAR_NS / 1e9 + blackbox.FINISH_S
    assert stop.REST_S < stop.END_SERVICE_S / 2
    starts = float(UNIT["StartLimitIntervalSec"]) / stop.END_SERVICE_S + 1
    assert starts < int(UNIT["StartLimitBurst"]) == 5, "an absent board is no crash loop"


def test_the_watchdog_waits_for_those_who_stop_first() -> None:
    first_ns = Settings().ns("gate.lease_s") + LEAVE_AFTER_NS
    assert float(UNIT["WatchdogSec"]) * 1e9 > 2 * first_ns


def test_rights_are_those_that_the_processes_ask_for() -> None:
    assert int(UNIT["LimitRTPRIO"]) >= max(row.priority for row in PROCESSES)
    assert UNIT["LimitMEMLOCK"] == "infinity"


def test_names_are_those_of_the_code() -> None:
    sysusers = (SYSTEMD / "failstop.sysusers").read_text()
    assert f"u {UNIT['User']} -" in sysusers
    assert f"m {UNIT['User']} dialout" in sysusers
    assert UNIT["Group"] == GROUP
    assert f"/var/lib/{UNIT['StateDirectory']}" == f"{SYSTEM_BASE}/failstop"
    assert f"/run/{UNIT['RuntimeDirectory']}" == "/run/failstop"


@pytest.mark.skipif(not shutil.which("systemd-sysusers"), reason="not installed: systemd-sysusers")
def test_sysusers_makes_the_user(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    command = ["systemd-sysusers", f"--root={tmp_path}", str(SYSTEMD / "failstop.sysusers")]
    if os.geteuid():
        pytest.skip("systemd-sysusers needs root")
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    passwd, group = ((tmp_path / "etc" / name).read_text() for name in ("passwd", "group"))
    user = passwd.splitlines()[0].split(":")
    assert user[0] == "failstop"
    assert int(user[2]) < 1000, "a system user: logind leaves its shared memory alone"
    assert user[5:] == ["/var/lib/failstop", "/usr/sbin/nologin"]
    assert re.search(r"^dialout:.*:failstop$", group, re.MULTILINE)
    assert re.search(r"^failstop:", group, re.MULTILINE)


RULE = re.compile(r'([A-Z]+(?:\{[\w/]+\})?)(==|!=|\+=|:=|=)"([^"]*)"')


def test_udev_rules_are_well_formed_and_for_this_board() -> None:
    lines = (SYSTEMD / "failstop.udev").read_text().splitlines()
    rules = [line for line in lines if line and not line.startswith("#")]
    for rule in rules:
        assert ", ".join("".join((key, op, f'"{value}"')) for key, op, value in RULE.findall(rule)) == rule
    link = next(rule for rule in rules if "SYMLINK" in rule)
    vendor, product = BOARD.usb[0].split(":")
    assert f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}"' in link
    users = next(rule for rule in rules if "MODE" in rule)
    assert f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", GROUP="dialout", MODE="0660"' in users
    assert 'TAG+="systemd"' in users
    device = next(rule for rule in rules if "power/control" in rule)
    assert 'ENV{FAILSTOP_PORT}=="1", ENV{ID_MM_DEVICE_IGNORE}="1", ATTR{power/control}="on"' in device
    assert 'ENV{FAILSTOP_PORT}=="1", ENV{BRLTTY_BRAILLE_DRIVER}=="?*"' in next(
        rule for rule in rules if "BRLTTY" in rule
    )
    assert "dev-failstop.device" in UNIT["WantedBy"]
    jumps = [value for rule in rules for key, _, value in RULE.findall(rule) if key in ("GOTO", "LABEL")]
    assert len(jumps) == 2
    assert len(set(jumps)) == 1


@pytest.mark.parametrize("sets", ['ENV{FAILSTOP_PORT}="1"', 'ENV{ID_MM_PORT_IGNORE}="1"'])
def test_the_rules_are_for_every_port_that_a_board_may_be_at(sets: str) -> None:
    """Others leave it alone: ModemManager looks at the device and at the port, brltty at the device."""
    named = set()
    for rule in (SYSTEMD / "failstop.udev").read_text().splitlines():
        if rule.endswith(sets):
            keys = {key.partition("{")[2].rstrip("}"): value for key, op, value in RULE.findall(rule) if op == "=="}
            named |= {f"{keys['idVendor']}:{product}" for product in keys["idProduct"].split("|")}
    assert named == {*ADAPTERS, *(usb for kind in BOARDS for usb in board_of(kind, 1.0, 0.0).usb)}
    vendors = {usb.partition(":")[0] for usb in named}
    postinst = (SYSTEMD.parent / "packaging/deb/postinst").read_text()
    assert set(re.findall(r"for vendor in ([\w ]+);", postinst)[0].split()) == vendors


@pytest.mark.parametrize(("chips", "has", "named"), [(["1a86/55d4"], "", True), (["1a86/55d4", "1546/1a8"], "", True),
    (["1a86/55d4", "1a86/55d4"], "", False), (["1546/1a8"], "", False), ([], "", False),
    (["1a86/55d4", "1a86/55d4"], "board", True), (["1a86/55d4", "1a86/55d4"], "other", False)])  # fmt: skip
def test_the_link_is_for_a_chip_that_one_device_alone_has(
    tmp_path: Path, chips: list[str], has: str, named: bool
) -> None:
    """The program of the rule, on a sysfs of this test's, for the tty `board`. `has`: the tty that has the link."""
    rule = next(line for line in (SYSTEMD / "failstop.udev").read_text().splitlines() if "PROGRAM" in line)
    (program,) = (value for key, _, value in RULE.findall(rule) if key == "PROGRAM")
    for number, chip in enumerate(chips):
        device = tmp_path / f"1-{number}"
        (device / "interface").mkdir(parents=True)
        (device / "uevent").write_text(f"MAJOR=189\nDEVTYPE=usb_device\nPRODUCT={chip}/443\n")
        (tmp_path / f"ttyACM{number}").mkdir()
        (tmp_path / f"ttyACM{number}" / "device").symlink_to(device / "interface")
    for node in ("board", "other"):
        (tmp_path / node).touch()
    if has:
        (tmp_path / "failstop").symlink_to(has)
    for path, ours in (("/sys/class/tty", ""), ("$devnode", "/board"), ("/dev/failstop", "/failstop")):
        assert path in program
        program = program.replace(path, f"{tmp_path}{ours}")
    done = subprocess.run(shlex.split(program), check=False, capture_output=True)
    assert (done.returncode == 0) is named


def test_the_bridges_unit_and_the_service_need_not_each_other() -> None:
    found = settings(BRIDGE)
    assert not {"PartOf", "Requires", "BindsTo", "Wants"} & {key for key, _ in found}
    given = dict(found)
    assert (given["User"], given["SupplementaryGroups"]) == ("%i", GROUP)
    assert given["Restart"] == "always"
    assert "ROS_LOG_DIR=/var/log/failstop-ros2" in given["Environment"]


@pytest.mark.parametrize("name", [BRIDGE, FLEET, WEB, GUARD])
def test_a_client_that_can_not_start_yet_is_started_again_for_as_long_as_it_takes(name: str) -> None:
    """systemd's own limit, five starts in 10 s, would end them for good after a boot at which an address comes late."""
    given = dict(settings(name))
    assert (given["Restart"], given["RestartSec"], given["StartLimitIntervalSec"]) == ("always", "1", "0")


def test_the_bridge_sources_the_newest_ros(tmp_path: Path) -> None:
    for name in ("humble", "jazzy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "setup.sh").write_text(f"export ROS_DISTRO={name}\n")
    words = shlex.split(dict(settings(BRIDGE))["ExecStart"].replace("$$", "$").replace("/opt/ros", str(tmp_path)))
    assert words[-2:] == ["/opt/failstop/bin/failstop", "ros2"]
    done = subprocess.run(
        [*words[:-2], "printenv", "ROS_DISTRO"], capture_output=True, text=True, timeout=20, check=True
    )
    assert done.stdout == "jazzy\n"


def test_the_fleets_unit_can_not_drive_and_the_service_does_not_need_it() -> None:
    found = settings(FLEET)
    given = dict(found)
    assert not {"PartOf", "Requires", "BindsTo", "Wants", "SupplementaryGroups", "Group", "User"} & set(given)
    assert (given["DynamicUser"], given["Restart"]) == ("yes", "always")
