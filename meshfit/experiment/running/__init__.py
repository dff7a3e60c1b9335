"""Running trials: scheduler, backends and workers."""
