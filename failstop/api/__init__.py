"""The part that programs use: the robot, its state, its events."""
