"""`python -m failstop_lab.sim`: the same as `failstop sim`."""

from __future__ import annotations

import argparse
import sys

from failstop_lab.sim.options import add_arguments, from_arguments
from failstop_lab.sim.serve import serve

_parser = argparse.ArgumentParser(prog="failstop sim", description="A simulated controller board on a pty.")
add_arguments(_parser)
sys.exit(serve(from_arguments(_parser.parse_args())))
