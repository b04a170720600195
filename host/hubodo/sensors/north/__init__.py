"""True north from Earth's rate."""
