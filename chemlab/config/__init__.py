"""Scenario files and data files: models, checks, loading."""
