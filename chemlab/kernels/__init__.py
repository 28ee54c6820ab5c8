"""Compiled code: decorators of kernels, declared arrays, random streams."""
