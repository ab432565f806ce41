"""Policy: the rules and tables that the service follows, such as the settings and the causes of a stop. All processes
use it. It doesn't depend on any process."""
