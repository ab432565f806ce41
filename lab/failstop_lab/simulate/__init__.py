"""Every single fault of a scenario, on a simulated machine, judged by the simulated board (README.md)."""
