"""The tier ``real``: laws that a chemist knows (docs/physics_real.md)."""
