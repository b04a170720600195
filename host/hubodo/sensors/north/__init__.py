"""North finding (gyrocompassing) on a turntable: the azimuth of table zero from Earth rate."""
