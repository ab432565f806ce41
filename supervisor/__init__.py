"""The parent: starts and watches the processes; has the latch, the stops and the events. Its loop is main.py."""
