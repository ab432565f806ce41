"""The units as text, and systemd's own tool that judges them."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from tests.support.pages import ROOT

SYSTEMD = ROOT / "systemd"
OLDEST = 249
"""The systemd of Ubuntu 22.04."""
BY_VERSION = (
    (239, "Description Type NotifyAccess ExecStart ExecStopPost TimeoutStartSec TimeoutStopSec Restart RestartSec"),
    (239, "KillMode WatchdogSec User Group UMask WantedBy OOMScoreAdjust LimitRTPRIO LimitMEMLOCK LimitCORE LimitNICE"),
    (239, "CapabilityBoundingSet AmbientCapabilities PrivateTmp PrivateNetwork PrivateMounts DevicePolicy DeviceAllow"),
    (239, "NoNewPrivileges SystemCallFilter SystemCallErrorNumber SystemCallArchitectures RestrictAddressFamilies"),
    (239, "RuntimeDirectory RuntimeDirectoryMode RuntimeDirectoryPreserve StateDirectory StateDirectoryMode"),
    (239, "ProtectSystem ProtectHome ProtectKernelTunables ProtectKernelModules ProtectControlGroups"),
    (239, "KeyringMode RestrictNamespaces OnFailureJobMode RestartPreventExitStatus"),
    (239, "OnFailure Conflicts After Wants Environment EnvironmentFile LogsDirectory SupplementaryGroups DynamicUser"),
    (239, "PrivateDevices LimitNOFILE CPUWeight MemoryMax TasksMax RestrictRealtime"),
    (239, "StartLimitIntervalSec StartLimitBurst MemoryDenyWriteExecute RemoveIPC LockPersonality IPAddressDeny"),
    (242, "RestrictSUIDSGID ProtectHostname"),
    (243, "OOMPolicy TimeoutAbortSec"),
    (244, "WatchdogSignal ProtectKernelLogs"),
    (245, "ProtectClock"),
    (247, "ProtectProc ProcSubset LoadCredential"),
    (248, "PrivateIPC"),
)
"""The version of systemd that each setting came with, 239 or before it for the first."""
SINCE = {key: version for version, keys in BY_VERSION for key in keys.split()}

needs_analyze = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="not installed: systemd-analyze")


def settings(name: str) -> list[tuple[str, str]]:
    lines = (SYSTEMD / name).read_text().splitlines()
    pairs = (line.partition("=") for line in lines if re.match(r"[A-Z]\w*=", line))
    return [(key, value) for key, _, value in pairs]


def analyze(*words: str) -> subprocess.CompletedProcess[str]:
    """systemd-analyze, which here sees no units but those that it is given and the machine's own."""
    return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, timeout=60, check=False)
