"""What README and reports say of fdd, measured; no part of what is installed. See ``python -m reports``."""
