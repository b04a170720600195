"""Names of the files of a batch; importable without the optional packages that `storage` needs."""

TABLE_FILE = "table.parquet"
PAGE_FILE = "fleet.html"
CALIBRATION_FILE = "calibration.toml"
PRIORS_FILE = "priors.toml"
