"""Published results: ``python -m studies.paper``, from the root of a checkout. Not part of the package."""
