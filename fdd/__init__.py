"""Fault detection and diagnosis for electro-hydrostatic actuators (EHAs)."""

from __future__ import annotations

__version__ = "0.1.0"
