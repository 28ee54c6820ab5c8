"""Beeler et al., "ChemGymRL: An Interactive Framework for Reinforcement Learning for Digital Chemistry" (2023).

`experiments.toml` repeats its experiments (``chemlab sweep``), `results/` has what they came to as tables,
`statements.toml` what the paper says of its own.
"""
