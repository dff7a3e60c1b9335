"""Layer 5: from a config to trials, their running, and the directory that holds their results."""
