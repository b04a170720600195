"""The files of settings that stand beside every changed log."""

from fuzz import seeds

SETTINGS = {"m.toml": seeds.MODEL.encode(), "v.toml": seeds.VEHICLE.encode()}
