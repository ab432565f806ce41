"""Shared memory: words, cells, segments, bells, claims, futexes, lifelines, heartbeats. It knows no robot."""
