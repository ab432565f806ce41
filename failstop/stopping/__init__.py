"""The stop without a service: the stop tool, and what it does before it opens the port."""
