"""What wanders at random beside a model, and what is left of the data with that followed."""
