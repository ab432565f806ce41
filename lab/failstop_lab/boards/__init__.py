"""Receivers of other boards, each a state machine from the firmware's source, and the line that leads to them."""
