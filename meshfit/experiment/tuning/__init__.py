"""Search for the settings that are best by some metrics."""
