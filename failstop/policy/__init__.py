"""Policy: the tables that the service follows: the settings, and the causes of a stop. It lies below every process and
imports none."""
