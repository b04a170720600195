"""A receiver's sentences to fixes."""
