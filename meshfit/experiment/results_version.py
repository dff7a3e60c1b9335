"""The version of results, in a module that commands can import without the libraries of a fit."""

RESULTS_VERSION = 3
"""Increased whenever the same settings give other numbers, so that older results are not taken for current ones.

It is the `schema_version` of a `result.json`, and part of each trial's identity.
"""
