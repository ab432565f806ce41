"""The operator's page. It runs in a process of its own, as a client of the service, and is not on the stop path
(docs/operator.md)."""
