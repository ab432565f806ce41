"""The service's processes, one folder each, and the modules that all of them need to start and run."""
