"""Benches and instruments: actions, observation channels, rewards. One implementation serves every environment."""
