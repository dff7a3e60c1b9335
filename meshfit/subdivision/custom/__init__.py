"""User-defined subdivision schemes."""
