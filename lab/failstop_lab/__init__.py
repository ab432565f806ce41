"""Laboratory: it breaks a robot on purpose: simulated board, fault table, campaigns, stand test; and what makes the
pages."""
