"""VESC: one motor controller with a steering servo, or two controllers. The second one is connected to the first by
CAN."""
