"""The stopper: the second stop channel, resident beside the service, and the one-shot stop tool."""
