"""Status of experiments: trial scan, remaining time, cleaning."""
