"""Step responses of several systems over one another."""

from __future__ import annotations
