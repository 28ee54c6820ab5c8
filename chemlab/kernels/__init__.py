"""Compilation: kernel decorators, schemas of arrays, random streams."""
