"""Configs: settings models, strict YAML, overrides and sweeps."""
