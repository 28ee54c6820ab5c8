"""Evaluation: policies on the same experiments, statistics, and figures and tables from results files."""
