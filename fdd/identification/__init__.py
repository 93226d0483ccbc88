"""A unit's own profile from its healthy logs: the thesis's chapters 5 and 6."""
