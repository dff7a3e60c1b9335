"""Registration: carry a template to a target so that each of its vertices arrives where it belongs."""
