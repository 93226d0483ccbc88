"""Recursive estimators with filterpy's interface: NumPy in, NumPy out.

Usable on its own; see ``README.md`` in this directory.
"""
