"""Screens: make lines of text from a state. Only terminal.py reads and writes a terminal."""
