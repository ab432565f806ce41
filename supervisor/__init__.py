"""The parent: starts and watches the processes; has the latch, the stops and the events. Its loop is main.py.

starter.py, entry.py, child.py: how it and its children start; run.py: what a run has. process_table.py, children.py:
the processes. stops.py, latch.py, aftermath.py: a stop, what is latched, what a written stop proves. port.py,
port_handover.py: the port. events.py, kinds.py, status.py, grant.py, fold.py: what people and programs are
told. blackbox.py: what is kept of a stop.
"""
