"""Public names, as docs/reference/public.txt records them: one a line, with what comes instead where one is deprecated.

SECURITY.md has the rule: a name that a release has may be gone in a later one only where that release says so.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator

from failstop.cli import main as cli
from failstop.fleet import metrics
from failstop.fleet import settings as fleet_settings
from failstop.policy import causes, settings
from failstop.ros2 import contract
from failstop.supervisor.kinds import EVENT_KINDS
from failstop.version import DEPRECATED, Renamed
from failstop_lab.pages import c_reference, completion, reference

PLACE = "docs/reference/public.txt"
DEPRECATED_FOR = "; deprecated: "
"""Between a name and what to use instead."""
MEMBER = re.compile(r"\| `(?:await )?(?P<name>\w+)(?:\((?P<given>.*)\))?[^`]*` \|")
"""A row of the reference."""


def text() -> str:
    """The whole file."""
    return "".join(
        f"{line}\n" for line in sorted({*_python(), *_deprecated(), *_commands(), *_settings(), *_words(), *_c()})
    )


def lost(before: str, now: str, *, minor: bool) -> list[str]:
    """The names of an earlier release's file that are gone and may not be: in a patch version all, in a `minor` one
    those that were not deprecated there."""
    kept = {line.partition(DEPRECATED_FOR)[0] for line in now.splitlines()}
    names = (line.partition(DEPRECATED_FOR) for line in before.splitlines())
    return [name for name, deprecated, _ in names if name not in kept and not (minor and deprecated)]


def _python() -> Iterator[str]:
    """Classes, what they have, and the arguments that it takes, as the reference shows them."""
    owner = ""
    for line in reference.page().splitlines():
        if line.startswith("### "):
            owner = line.split()[1]
            yield f"python {owner}"
        elif owner and (found := MEMBER.match(line.replace("\\|", "|"))):
            name = found["name"] if found["name"] == owner else f"{owner}.{found['name']}"
            yield f"python {name}"
            yield from (f"python {name}({argument})" for argument in _arguments(found["given"] or ""))


def _c() -> Iterator[str]:
    """The functions of failstop.h with the types that they take, the numbers of its enums, and where each field of a
    struct is among the others."""
    yield from (f"c {member}" for member in c_reference.members())
    for declared in c_reference.functions():
        yield f"c {declared}"


def _deprecated() -> Iterator[str]:
    """Old names that are still taken, each with the new one."""
    for home in {module for _, module, _ in reference.SECTIONS}:
        for owner, shown in vars(importlib.import_module(f"failstop.api.{home}")).items():
            if not isinstance(shown, type) or owner.startswith("_") or owner in reference.PAGE_OF:
                continue
            for name, old in (each for base in shown.__mro__ for each in vars(base).items()):
                if isinstance(old, Renamed):
                    yield f"python {owner}.{name}{DEPRECATED_FOR}{old.new}"
    yield from (
        f"{'option' if ' ' in word else 'setting'} {word}{DEPRECATED_FOR}{new}" for word, new in DEPRECATED.items()
    )


def _arguments(given: str) -> list[str]:
    function = ast.parse(f"def shown({given}): pass").body[0]
    assert isinstance(function, ast.FunctionDef)
    taken = function.args
    return [each.arg for each in (*taken.args, *taken.kwonlyargs, *filter(None, (taken.vararg,)))]


def _commands() -> Iterator[str]:
    for name in cli.COMMANDS:
        for parser in completion.walk(cli.load(name)[0]):
            command = parser.prog.removeprefix("failstop ")
            yield f"command {command}"
            for action in completion.arguments(parser):
                yield from (f"option {command} {flag}" for flag in action.option_strings)


def _settings() -> Iterator[str]:
    yield from (f"setting {setting.key}" for setting in settings.DECLARED)
    for family, declared in settings.FAMILIES.items():
        yield from (f"setting {family}.NAME.{setting.key}" for setting in declared)
    yield from (f"fleet-setting {setting.key}" for setting in fleet_settings.DECLARED)


def _words() -> Iterator[str]:
    """Names that programs find in the journal, in ROS, and in what Prometheus reads."""
    yield from (f"cause {kind.name}" for kind in causes.BY_NUMBER.values())
    for event in EVENT_KINDS:
        yield from (f"event {event.name}", *(f"event {event.name} {field}" for field in event.fields.split()))
    topics = (*contract.INWARD, *contract.OUTWARD, contract.TF, contract.ARM_GOAL, contract.ARM_BUSY)
    services = (*contract.SERVICES, *contract.ARM_SERVICES, contract.ARM_ACTION)
    yield from (f"ros {row.name} {row.type}" for row in topics)
    yield from (f"ros {row.name} {row.type}" for row in services)
    yield from (f"ros ~/state {key}" for key in contract.STATE_KEYS)
    yield from (f"metric {family.name}" for family in metrics.FAMILIES)
