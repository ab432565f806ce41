"""The ROS package of failstop's bridge."""
