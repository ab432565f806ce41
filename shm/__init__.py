"""Shared memory and waiting: words, cells, segments, bells, claims, futexes, lifelines and heartbeats. Nothing in this
folder is about robots."""
