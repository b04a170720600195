"""File names of a batch that several modules use."""

TABLE = "table.parquet"
PAGE = "fleet.html"
CALIBRATION = "calibration.toml"
PRIORS = "priors.toml"
