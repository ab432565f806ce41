"""Start: the service on the page. First the numbers of Linux's modules are put where a browser's Python lacks them."""

from __future__ import annotations

import importlib
import os
import sys
from collections import namedtuple
from types import ModuleType

import linux

for name, values in linux.VALUES.items():
    try:
        module = importlib.import_module(name)
    except ImportError:
        module = sys.modules[name] = ModuleType(name)
        module.__dict__["error"] = OSError
    for key, value in values.items():
        module.__dict__.setdefault(key, value)

os.__dict__.setdefault("sched_param", namedtuple("sched_param", "sched_priority"))

from failstop_lab.browser.show import Show, table  # noqa: E402

show, acts = Show(), table()
