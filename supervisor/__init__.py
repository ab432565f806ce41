"""The parent: settings, process table, watch, stop authority, restarts."""
