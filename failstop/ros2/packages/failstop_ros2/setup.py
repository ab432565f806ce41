"""The ROS package: an executable and a launch file for the bridge. The bridge itself is part of failstop."""

from setuptools import setup

NAME = "failstop_ros2"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", ["config/bridge.yaml"]),
        (f"share/{NAME}/launch", ["launch/failstop.launch.py"]),
    ],
    install_requires=["setuptools"],
    tests_require=["pytest"],
    zip_safe=True,
    maintainer="failstop developers",
    maintainer_email="failstop@example.org",
    description="The bridge from ROS 2 to failstop, which stops a robot when its software fails, and its launch file.",
    license="MIT",
    entry_points={"console_scripts": [f"bridge = {NAME}.bridge:main"]},
)
