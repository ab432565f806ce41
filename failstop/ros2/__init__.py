"""The ROS 2 bridge: a client of the service like any other, which lets the robot's ROS nodes drive through it.

contract.py: every topic, service and parameter, as data. commanders.py, scan.py: who may command, and what is heard of
the obstacle sensor. messages.py, report.py, diagnostics.py, words.py, mirrors.py: what is told, as plain data.
transport.py: the way that it takes. All of these are pure. link.py, inward.py, outward.py, bridge.py: the shell around
them, which alone knows rclpy.

It uses Robot and State and nothing below them, so whatever becomes of it costs its own commands and no more.
"""
