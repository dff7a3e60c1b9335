"""Layer 3: how far a result is from its target, and how sound it is; `measure` takes all the figures at once."""
