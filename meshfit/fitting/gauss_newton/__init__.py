"""The Gauss–Newton engine: sparse normal equations, solved coarse to fine through a subdivision scheme."""
