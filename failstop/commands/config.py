"""`failstop config`: every setting with its value, unit and origin."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from failstop.supervisor import config
from failstop.supervisor.settings import DECLARED


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop config`."""
    parser.add_argument("--config", metavar="FILE", help="the TOML file to read over the defaults")


def main(arguments: Namespace) -> int:
    """Print the table; raises SettingError when the file is not right."""
    settings = config.load(arguments.config)
    for setting in DECLARED:
        value = settings.values[setting.key]
        origin = "default" if value == setting.default else arguments.config
        print(f"{setting.key:<28} {value!s:>14} {setting.unit:<7} {origin:<10} {setting.doc}")
    return 0
