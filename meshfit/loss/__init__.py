"""The loss terms of first-order fits, as functions of tensors."""
