"""Scripted policies: hand-written policies that use observations, masks and the public scenario only."""
