"""What is to be explained: a log and a model brought together."""
