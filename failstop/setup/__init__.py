"""Setup: a conversation in a terminal. It starts with the board's cable and ends with a robot whose stops have been
tested."""
