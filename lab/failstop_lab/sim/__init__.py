"""The simulated controller board: a model of the board behind a pseudo-terminal, and the judge in every test."""
