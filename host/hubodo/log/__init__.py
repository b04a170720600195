"""The one door to recordings: MCAP, CSV folders, damage, conversion."""
