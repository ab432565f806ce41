"""The stopper: a second process that can stop the robot when the port owner or the supervisor can't."""
