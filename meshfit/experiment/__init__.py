"""Experiments: plan, runs, run directory and status."""
