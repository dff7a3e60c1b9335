"""The laboratory: what a scheme does, computed from the operators that it is laid down as."""
