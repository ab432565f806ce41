"""The port owner: keeps the port, and is the only writer of motion frames."""
