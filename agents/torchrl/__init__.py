"""TorchRL environment over batched laboratories, and a BenchMARL task."""
