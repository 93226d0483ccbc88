"""One module a command; each writes one report."""
