"""The ROS 2 bridge: lets the robot's ROS nodes drive through the service. It is a client of the service like any other.

contract.py declares every topic, service and parameter as data. commanders.py decides who may command, and scan.py
watches the obstacle sensor. messages.py, report.py, diagnostics.py, words.py and mirrors.py make the content of
messages as plain data. transport.py chooses the transport of DDS. These modules are all pure. link.py, inward.py,
outward.py, arm.py, trajectory.py and bridge.py connect them to ROS and to the service.

The bridge reaches the service only through the API. So if the bridge fails, only the commands that it sent are lost.
"""
