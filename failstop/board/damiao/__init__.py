"""Damiao: two to four CAN servo motors behind a serial CAN adapter. Each motor turns a wheel."""
