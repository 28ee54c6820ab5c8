"""Beeler et al., "ChemGymRL: An Interactive Framework for Reinforcement Learning for Digital Chemistry" (2023).

`experiments.toml` repeats its experiments (``chemlab sweep``), `results/` has their results as tables, and
`statements.toml` the paper's own statements.
"""
