"""Shared memory: words, cells, segments, bells, claims, futexes, lifelines, heartbeats. Nothing here is about
robots."""
