"""Subdivision schemes, declared as masks and assembled into sparse operators."""
