"""Layer 2: the loss terms of first-order fits, as functions of tensors."""
