"""Table of faults with their expected outcome and the counter that shows them."""
