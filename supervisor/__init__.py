"""The parent: starts and watches the processes; has the latch, the stops and the events. Its loop is main.py.

starter.py, entry.py, child.py: how it and its children start; run.py: what a run has. process_table.py, children.py:
the processes. stops.py, latch.py, proof.py, monitor.py: a stop, what is latched, what an answered stop proves, and who
looks for that. port_handover.py: the port. events.py, kinds.py, status.py: what people and programs are told.
blackbox.py: what is kept of a stop.
"""
