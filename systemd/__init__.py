"""The files of the system: units, the user, the udev rule, the journal's catalog. Package data."""
