"""Names of the metrics, their directions and units; importing them costs nothing."""

METRICS = ("mse", "rmse", "mae", "abs_rel", "delta1", "delta2", "delta3", "log10", "silog", "ssim")
LOWER_IS_BETTER = frozenset(("mse", "rmse", "mae", "abs_rel", "log10", "silog"))
CLASS_METRICS = ("abs_rel", "rmse", "delta1")
UNITS = {"mse": "m^2", "rmse": "m", "mae": "m"}  # the others are pure numbers
