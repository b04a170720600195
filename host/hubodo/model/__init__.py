"""The forward model and the virtual node: what a wheel-mounted sensor measures."""
