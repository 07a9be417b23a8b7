"""Effects of the air: what lies between the eye and space."""
