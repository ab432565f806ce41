"""Screens: turn a state into lines of text. Only terminal.py uses a terminal."""
