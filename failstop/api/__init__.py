"""What programs use: the robot, its state, its events."""
