"""Allan deviation of a stationary sensor, its noise terms and their confidence intervals."""
