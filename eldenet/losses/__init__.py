"""Training losses: terms that ignore unknown pixels, and their weighted sum."""
