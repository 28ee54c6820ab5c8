"""Roles: the manager and the benches, with their operations and instruments."""
