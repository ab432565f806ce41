"""Policy: the tables that the service follows, such as the settings and the causes of a stop. All processes import it,
and it imports none of them."""
