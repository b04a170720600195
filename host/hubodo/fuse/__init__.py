"""Estimators: measurements in, states out; no port, file, clock or thread."""
