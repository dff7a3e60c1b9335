"""The second engine: Gauss–Newton steps on sparse normal equations, coarse to fine through a subdivision scheme."""
