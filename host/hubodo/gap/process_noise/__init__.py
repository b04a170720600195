"""Process noise of a model and the residuals with that noise removed."""
