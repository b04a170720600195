"""An effect that nobody listed yet: the dependence that the log shows, as a Python class to go on with."""
