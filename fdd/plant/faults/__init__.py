"""Faults: what is asked for (`spec`) and what it does to the plant (`injection`)."""
