"""Pictures in float64: `march` from samples, `exact` from a known function."""
