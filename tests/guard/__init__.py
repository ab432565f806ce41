"""The guard port."""
