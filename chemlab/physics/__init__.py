"""Kernels on arrays: what a vessel does, equation by equation. They hold no state and draw no randomness."""
