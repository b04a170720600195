"""Virtual nodes: emulated chips and boards that run the real firmware."""
