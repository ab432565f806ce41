"""Damiao: two to four CAN servo motors, each of which turns a wheel, behind a serial CAN adapter."""
