"""The operator's page: a sixth process, a client of the service and outside of its stop path (docs/operator.md)."""
