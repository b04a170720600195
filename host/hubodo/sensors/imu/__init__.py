"""Scale, cross-axis terms and bias of both triads from poses and turns."""
