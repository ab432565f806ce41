"""What breaks a robot on purpose: simulated board, fault table, campaigns, stand test. A robot needs none of it."""
