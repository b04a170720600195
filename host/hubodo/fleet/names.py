"""Names of the files of a batch that more than one of its parts knows."""

TABLE = "table.parquet"
PAGE = "fleet.html"
CALIBRATION = "calibration.toml"
PRIORS = "priors.toml"
