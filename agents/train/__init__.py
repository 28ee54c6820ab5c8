"""Training on Stable-Baselines3: what a run is, runs that can be interrupted, many of them, and what ships of them."""
