"""Functions of volumes that are larger than memory: coefficients of one brick after the other, within a budget.

docs/architecture.md has its modules; the site's page "Modules", made from their docstrings, what each holds.
"""
