"""Setup: a conversation in a terminal that begins with the board's cable and ends with a robot whose stops were
tested."""
