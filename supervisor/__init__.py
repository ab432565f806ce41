"""The supervisor: starts and watches the other processes, latches stops, and logs events. Its loop is in main.py."""
