"""The function between the samples: coefficients on a device, and functions of them.

docs/architecture.md has its modules; the site's page "Modules", made from their docstrings, what each holds.
"""
