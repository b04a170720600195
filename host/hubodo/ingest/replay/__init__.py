"""A recording as it came: at its pace or through a port."""
