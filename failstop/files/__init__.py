"""Files: the runtime directory of a service, the files in it, and the files that are kept after the service has
ended."""
