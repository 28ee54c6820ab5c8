"""Training with Stable-Baselines3: tasks, resumable runs, sweeps, and export."""
