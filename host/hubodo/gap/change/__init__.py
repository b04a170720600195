"""Two logs of one vehicle: what has changed between them, and how likely it is that nothing has."""
