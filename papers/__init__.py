"""What is published of results: ``python -m papers``, from the root of a checkout. It is no part of the package."""
