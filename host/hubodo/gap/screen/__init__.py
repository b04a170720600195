"""Screening: the gain of every candidate in the linear model, by score tests."""
