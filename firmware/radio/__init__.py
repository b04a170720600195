"""Nodes without a cable, by nRF24L01+ to a receiver. Apart: a folder of many files is slow to search."""
