"""Training losses that ignore unknown pixels, and their weighted sum."""
