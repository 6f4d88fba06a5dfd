"""Pictures in float64: `march` from samples, `exact` from a function that is known everywhere."""
