"""The forward model: what a wheel-mounted sensor measures, from the motion of the vehicle."""
