"""Fits by other tools: any command, or one of the ready entries, each in a process of its own."""
