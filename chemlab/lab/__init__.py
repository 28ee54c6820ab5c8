"""The laboratory: turns, rewards, hidden parameters, initial states."""
