"""What a data set's folder is made of: names of its files, and the hash that holds them together."""

from __future__ import annotations

import hashlib

DATASET_SCHEMA = "fdd.dataset/1"
RECIPE = "recipe.yaml"
LABELS = "labels.json"
MANIFEST = "manifest.json"
"""Written last: a folder without it is unfinished."""
CARD = "README.md"
SUMS = "SHA256SUMS"
"""Hashes of all other files, as sha256sum has them."""
PARTS = ".parts"
"""Label of each finished run, until the data set is complete."""
TRUE_UNIT = "true_unit.yaml"
BASE_UNIT = "base_unit.yaml"
"""The data sheet that the unit was varied from, where no shipped profile is it."""


def digest(recipe_text: str, labels_text: str) -> str:
    """SHA-256 over a data set's labels and recipe, as its files have them."""
    return hashlib.sha256(labels_text.encode() + b"\0" + recipe_text.encode()).hexdigest()
