"""Setup: from a cable to a proved robot, as a conversation in a terminal."""
