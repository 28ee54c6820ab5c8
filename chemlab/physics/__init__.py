"""Physics kernels on arrays. They hold no state and draw no random numbers."""
