"""The operator's page: a web page with STOP, the robot's state, and its incidents. It runs in a separate process as a
client of the service, and no stop of the service depends on it (docs/operator.md)."""
