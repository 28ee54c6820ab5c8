"""Studies: reproductions, baselines, validation of the physics, and benchmarks, with their committed results."""
