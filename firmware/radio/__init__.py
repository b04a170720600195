"""Nodes without a cable, by nRF24L01+ or ESP-NOW to a receiver. Apart: many files are slow to search."""
