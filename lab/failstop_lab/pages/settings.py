"""The page docs/reference/settings.md: every setting, made from the declarations of failstop/policy/settings.py."""

from __future__ import annotations

from failstop.board.kinds import ALL_KINDS, facts_of
from failstop.cli.commands.config import GROUPS, literal
from failstop.policy.settings import DECLARED, FAMILIES, LONGEST_NAME, MOST_OF_A_FAMILY

TOGETHER = (
    "`gate.period_s` < `gate.lease_s` < `gate.command_timeout_s` and every source's `timeout_s`",
    "`gate.period_s` <= `gate.refresh_s` <= half of the time after which the board's own watchdog acts",
    "`restart.backoff_s` < `restart.window_s`",
    "no two wheels have the same id; a robot of two or three wheels has no settings of the others",
    'a `board.kind` of two speeds has `wheels.layout = "differential"`; only '
    + " and ".join(f"`{kind}`" for kind in ALL_KINDS if (facts := facts_of(kind)) and facts.arm)
    + " have joints",
    "no two sources have the same priority",
    "no two joints have the same servo; `low` < `high`, and both poses between them",
    "`pad.mode_button` is exactly one bit",
)


def page() -> str:
    """The whole page."""
    lines = [
        "# Settings",
        "",
        "On this page you can look up every setting, with its default and the allowed values. All settings are in one",
        "TOML file, which `failstop run --config FILE` reads once. If a setting is unknown, out of range or",
        "contradicts another one, it is refused with its key, its value and the allowed values.",
        "",
        'Write one line for each setting with its whole name, for example `device.path = "/dev/ttyUSB0"`. You may add',
        "such lines anywhere, also at the end. If you group lines below a `[table]`, leave out the table's name there",
        "(`[device]`, then `path = ...`), and put whole names above the first table.",
        "",
        "| command | what it does |",
        "|---|---|",
        "| `failstop config` | prints every value, and where it comes from |",
        "| `failstop config --check FILE` | checks a file |",
        "| `failstop config --example` | prints a file with every setting in it, all commented out |",
        "",
        "Generated from the declarations in failstop/policy/settings.py (`make docs`).",
    ]
    for group, what in GROUPS.items():
        found = [(setting.key, setting) for setting in DECLARED if setting.key.partition(".")[0] == group]
        found += [(f"{group}.NAME.{setting.key}", setting) for setting in FAMILIES.get(group, ())]
        lines += ["", f"## {group}", "", what]
        if group in FAMILIES:
            lines += [f"NAME is 1 to {LONGEST_NAME} of `a-z 0-9 _ -`; at most {MOST_OF_A_FAMILY} tables."]
        lines += ["", "| setting | default | allowed | meaning |", "|---|---|---|---|"]
        lines += [
            f"| `{key}` | `{literal(setting, setting.default)}` | {setting.range()} | {setting.doc} |"
            for key, setting in found
        ]
    lines += ["", "## Values that must fit together", "", *(f"- {rule}" for rule in TOGETHER)]
    return "\n".join(lines) + "\n"
