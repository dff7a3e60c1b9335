"""Layer 4: configs. Frozen models, strict YAML, overrides, JSON Schema."""
