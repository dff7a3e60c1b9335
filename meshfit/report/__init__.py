"""Layer 6: from results to tables, their formats, and the check against expected numbers."""
