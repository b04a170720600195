"""Serial, TCP and UDP links: opening, reading, writing and reconnecting."""
