"""Scripted policies: what an undergraduate chemist would do, from observations, masks and the public scenario alone."""
