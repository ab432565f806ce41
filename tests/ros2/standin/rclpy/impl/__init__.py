"""The stand-in's internals."""
