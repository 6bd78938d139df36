"""Names of the metrics, their directions and units; importing them costs nothing."""

METRICS = ("mse", "rmse", "mae", "abs_rel", "delta1", "delta2", "delta3", "log10", "silog", "ssim")
LOWER_IS_BETTER = frozenset(
    (
        *("mse", "rmse", "mae", "abs_rel", "log10", "silog", "ause_abs_rel", "ause_rmse", "abs_rel_sure80"),
        *("nll", "scale_error"),  # the last one of adapt
    )
)
# of a network that predicts its sigma, see evaluation/uncertainty_metrics.py
UNCERTAINTY_METRICS = (
    *("ause_abs_rel", "ause_rmse", "abs_rel_sure80"),
    *("coverage50", "coverage80", "coverage90", "coverage95", "nll"),
)
CLASS_METRICS = ("abs_rel", "rmse", "delta1")
UNITS = {"mse": "m^2", "rmse": "m", "mae": "m"}  # the others are pure numbers
# the values that a metric can have; every other figure of a record (a cost, a count) is 0 or more
LARGEST = 1e30  # of any figure: tables compute with it
SHARES = ("delta1", "delta2", "delta3", "coverage50", "coverage80", "coverage90", "coverage95")
RANGES = dict.fromkeys(SHARES, (0.0, 1.0)) | {"ssim": (-1.0, 1.0), "nll": (-LARGEST, LARGEST)}


def in_range(name: str, value: object, *, low: float = 0.0) -> bool:
    """Return whether a value is a finite number that the metric or cost can have, or None (NaN)."""
    if value is None:
        return True
    least, most = RANGES.get(name, (low, LARGEST))
    rounding = 1e-6 if name in RANGES else 0.0
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= LARGEST
        and least - rounding <= value <= most + rounding
    )
