"""Changes of a vehicle between two logs."""
