"""The version of this package, in the one place that both the build and the running processes read."""

VERSION = "0.1.0"
