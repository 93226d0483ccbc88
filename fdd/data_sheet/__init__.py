"""A base profile typed from a data sheet: the questions, the profile they make, and whether it can be."""
