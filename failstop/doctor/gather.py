"""Gathering: every fact, each looked at once. All but the two self-tests takes less than two seconds."""

from __future__ import annotations

import os

from failstop import config
from failstop.api.errors import FailstopError
from failstop.discovery import BOARD_PID, BOARD_VID
from failstop.doctor import machine_facts, paste, port_facts, ros2_facts, service_facts, stop_test, ticks
from failstop.doctor.facts import NAMED, Facts, Holder, Node, Service, StopTest, Unit, User
from failstop.doctor.system import System
from failstop.policy.settings import SettingError, Settings
from failstop.shm.instance import check_name

ACCOUNT = "failstop"
BOARD_USB = f"{BOARD_VID:04x}:{BOARD_PID:04x}"


def gather(
    name: str, config_path: str | None, device: str | None, *, quick: bool, stop_test_wanted: bool, system: System
) -> Facts:
    """Everything. `quick`: without the timing self-test; `stop_test_wanted`: a running service may be told to stop.
    Raises InstanceError for a name that is none."""
    check_name(name)
    config_path, settings, problem = _settings_or_problem(name, config_path, system)
    service = service_facts.service(name, system)
    path, origin = _device(device, service, settings.text("device.path"), config_path)
    node = port_facts.node(path, system)
    systemd = os.path.isdir(system.path("/run/systemd/system"))
    unit = service_facts.unit(name) if systemd else None
    user = port_facts.user(os.geteuid())
    service_user = _service_user(unit)
    state = service.state if service else None
    ours = {row.pid for row in state.processes.values()} if state else set()
    holders, unseen = port_facts.holders(node.resolved, ours, system) if node else ((), 0)
    stops, skipped, stop_fix = _stops(name, node, service, holders, named=device is not None, wanted=stop_test_wanted)
    return Facts(
        name=name,
        device=path,
        device_origin=origin,
        user=user,
        service_user=service_user,
        rights=machine_facts.rights(system),
        clock=machine_facts.clock(system),
        memory=machine_facts.shared_memory(service_user or user, system),
        cpu=machine_facts.cpu(system),
        lease_s=settings["gate.lease_s"],
        period_s=settings["gate.period_s"],
        settings_file=config_path or "",
        settings_problem=problem,
        node=node,
        candidates=() if node else port_facts.candidates(),
        holders=holders,
        unplugged=port_facts.unplugged(system),
        unseen_processes=unseen,
        grabbers=port_facts.grabbers(system),
        service=service,
        systemd=systemd,
        unit=unit,
        remove_ipc=service_facts.remove_ipc(system) if systemd else None,
        ros2=ros2_facts.ros2(service, system),
        ticks=() if quick else ticks.measure(),
        stops=stops,
        stop_skipped=skipped,
        stop_fix=stop_fix,
        stop_wanted=stop_test_wanted,
        commands=paste.commands(os.environ),
    )


def settings_of(name: str, path: str | None, system: System) -> tuple[str | None, Settings]:
    """The file that was named, else the installed one, else the defaults. Raises SettingError."""
    installed = system.path(config.installed(name))
    if path is None and os.access(installed, os.R_OK):
        path = installed
    return path, config.load(path)


def _settings_or_problem(name: str, path: str | None, system: System) -> tuple[str | None, Settings, str]:
    try:
        return *settings_of(name, path, system), ""
    except SettingError as error:
        return path, Settings(), str(error)


def _device(option: str | None, service: Service | None, setting: str, config_path: str | None) -> tuple[str, str]:
    if option:
        return option, NAMED
    if service and service.state and service.state.device.path:
        return service.state.device.path, "of the running service"
    return setting, config_path or "the default of device.path"


def _service_user(unit: Unit | None) -> User | None:
    if unit and unit.load == "loaded":
        return port_facts.account(unit.user)
    return port_facts.account(ACCOUNT)


_Stops = tuple[tuple[StopTest, ...], str, str]
"""What was tested; why it was left out; the command by which it would be tested."""


def _stops(
    name: str, node: Node | None, service: Service | None, holders: tuple[Holder, ...], *, named: bool, wanted: bool
) -> _Stops:
    """The self-test where it is safe, else why it was left out."""
    if service:
        return _of_service(name, service, wanted=wanted)
    if node is None or not node.character:
        return (), "there is no port", ""
    if not node.accessible:
        return (), "this user may not open the port", ""
    if holders:
        return (), f"{holders[0].name} (pid {holders[0].pid}) has the port open", ""
    if not (named or node.pseudo or node.usb_id == BOARD_USB):
        return (
            (),
            f"{node.path} may not be the board, and it is not written to",
            f"failstop doctor --device {node.path}",
        )
    return stop_test.by_hand(node.path), "", ""


def _of_service(name: str, service: Service, *, wanted: bool) -> _Stops:
    if not (state := service.state):
        return (), "the running service can't be asked", ""
    if state.enabled:
        return (), "motion is enabled", f"failstop disable --name {name}"
    if state.cause:
        return (), f"a stop is latched already ({state.cause})", f"failstop reset --name {name}"
    if not wanted:
        return (), "the service runs, and would be stopped once and reset", f"failstop doctor --stop-test --name {name}"
    if problem := stop_test.no_right(name):
        return (), problem, f"sudo failstop doctor --stop-test --name {name}"
    try:
        return stop_test.by_service(name), "", ""
    except FailstopError as error:
        return (StopTest("port owner, by a stop request", False, None, str(error)),), "", ""
