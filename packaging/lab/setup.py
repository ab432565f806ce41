"""failstop-lab: the simulated board, the demo, the faults and the stand test, of the version that failstop has."""

import runpy
from pathlib import Path

from setuptools import find_packages, setup

VERSION = runpy.run_path(str(Path(__file__).resolve().parent / "failstop" / "version.py"))["VERSION"]

setup(
    name="failstop-lab",
    version=VERSION,
    description="failstop's laboratory: simulated board, demo, fault campaign, stand test.",
    license="MIT",
    python_requires=">=3.10,<3.14",
    packages=["failstop.lab", *(f"failstop.lab.{name}" for name in find_packages("failstop/lab"))],
    install_requires=[f"failstop=={VERSION}"],
)
