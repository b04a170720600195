"""The model linearised about a state, along every parameter of every effect."""
