"""GNSS receivers: NMEA decoding and logging of fixes."""
