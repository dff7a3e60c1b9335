"""Files of a run directory: each module writes and reads one kind."""
