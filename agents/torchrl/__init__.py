"""Laboratories for learners of TorchRL: an environment over the batch, and a task for BenchMARL."""
