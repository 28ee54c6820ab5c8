"""Environments: PettingZoo, Gymnasium, batches of laboratories."""
