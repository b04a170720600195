"""Units that more than one room converts by."""

from typing import Final

NS_PER_S: Final = 1_000_000_000
