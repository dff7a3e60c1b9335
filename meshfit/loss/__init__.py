"""Layer 2: the terms of the fitting objective, each a function of tensors."""
