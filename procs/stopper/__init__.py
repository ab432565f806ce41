"""The stopper: the second stop channel, resident next to the service, and the one-shot stop tool."""
