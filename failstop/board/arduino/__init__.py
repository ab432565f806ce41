"""Arduino: an AVR with ros_arduino_bridge on its USB serial port, as the ROS 2 package diffdrive_arduino drives it."""
