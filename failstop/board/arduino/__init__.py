"""Arduino: ros_arduino_bridge on an AVR, as diffdrive_arduino drives it, on its USB serial port."""
