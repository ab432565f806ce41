"""VESC: one motor controller with a steering servo, or two of which the second is behind the first's CAN."""
