"""The gap between simulation and measurement: missing effects, and the model completed with them."""
