"""Layer 7: the commands. Each parses, calls, prints; the only place that prints or exits."""
