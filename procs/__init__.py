"""The service's processes, one folder each, and the modules that starting and running any of them needs."""
