"""failstop-lab: simulated boards and machine, demo, faults and stand test. Its version is failstop's."""

import runpy
from pathlib import Path

from setuptools import find_packages, setup

CHECKOUT = Path(__file__).resolve().parents[1]
VERSION = runpy.run_path(str(CHECKOUT / "failstop" / "version.py"))["VERSION"]

setup(
    name="failstop-lab",
    version=VERSION,
    description="failstop's laboratory: simulated boards, demo, faults, stand test.",
    license="MIT",
    license_files=["LICENSE"],
    python_requires=">=3.10,<3.15",
    packages=find_packages(include=["failstop_lab", "failstop_lab.*"]),
    install_requires=[f"failstop=={VERSION}"],
)
