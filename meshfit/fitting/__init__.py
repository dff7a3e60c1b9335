"""Fitting a source to a target in torch, with a first-order and a Gauss–Newton engine."""
